"""Kernels that something launches, by their hashes: an edit must compile none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

import djpt

__all__ = ["Watched", "kernels"]


def kernels(action: Callable[[], Any]) -> set[str]:
    """Hashes of the kernels that `action` launches."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        action()
        dr.sync_thread()
        return {entry["hash"] for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT}


class Watched:
    """A scene whose kernels are known: `new` says which ones an edit adds."""

    def __init__(self, description: dict[str, Any], gradients: tuple[str, ...] = (), **options: Any) -> None:
        self.scene = djpt.load_dict(description)
        self.params = djpt.traverse(self.scene)
        self.gradients, self.options = gradients, {"spp": 4, **options}
        self.known: set[str] = set()
        for _ in range(2):
            self.new()

    def new(self, **options: Any) -> int:
        """Render, and count kernels not seen before."""
        hashes = kernels(lambda: self.render(**options))
        count = len(hashes - self.known)
        self.known |= hashes
        return count

    def render(self, **options: Any) -> None:
        for name in self.gradients:
            dr.enable_grad(self.params[name])
            self.params.set_dirty(name)
        if self.gradients:
            self.params.update()
        image = djpt.render(self.scene, self.params, **{**self.options, **options})
        if self.gradients:
            dr.backward(dr.sum(dr.square(image.array)))
        dr.eval(image)

    def edit(self, **values: Any) -> int:
        for name, value in values.items():
            self.params[name] = value
        self.params.update()
        return self.new()
