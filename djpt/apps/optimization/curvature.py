"""The curvature of a search: one bound for each view, measured again now and then."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["Curvatures"]

Doubles = npt.NDArray[np.float64]

USES = 8
"""The uses of a view's curvature before it is measured again: derivatives change with the parameters."""


class Curvatures:
    """Bounds on the curvature of the losses of all views.

    Args:
        views: the numbers of the sensors.
        measured: gives the bounds of a view by the names of the variables; called with the view and the number of the
            measurement.
    """

    def __init__(self, views: Sequence[int], measured: Callable[[int, int], Mapping[str, Doubles]]) -> None:
        self._measured, self._measurements = measured, 0
        self._bounds: dict[int, Mapping[str, Doubles]] = {}
        self._uses = dict.fromkeys(views, 0)

    def forget(self) -> None:
        """Measure all views again before they are used."""
        self._bounds = {}
        self._uses = dict.fromkeys(self._uses, 0)

    def of(self, views: Sequence[int]) -> tuple[dict[str, Doubles], bool]:
        """A bound on the mean loss of any views, as many as these, and whether one of these was measured for it.

        It is the mean of the largest bounds of single views, for each entry: what some views don't show at all isn't
        changed too much when others are looked at.
        """
        due = [view for view in dict.fromkeys(views) if self._uses[view] % USES == 0]
        for view in due:
            self._bounds[view] = self._measured(view, self._measurements)
            self._measurements += 1
        for view in views:
            self._uses[view] += 1
        names = self._bounds[views[0]]
        stacks = {name: np.sort(np.stack([b[name] for b in self._bounds.values()]), axis=0) for name in names}
        return {name: stack[-len(set(views)) :].mean(axis=0) for name, stack in stacks.items()}, bool(due)

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """All that is known, to be kept in a file."""
        found: dict[str, npt.NDArray[np.generic]] = {"measurements": np.array(self._measurements)}
        found |= {f"uses:{view}": np.array(uses) for view, uses in self._uses.items()}
        for view, bounds in self._bounds.items():
            found |= {f"bound:{view}:{name}": bound for name, bound in bounds.items()}
        return found

    def restore(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Take back what `arrays` gave."""
        self.forget()
        bounds: dict[int, dict[str, Doubles]] = {}
        for key, array in arrays.items():
            kind, _, rest = key.partition(":")
            if kind == "measurements":
                self._measurements = int(array)
            elif kind == "uses":
                self._uses[int(rest)] = int(array)
            elif kind == "bound":
                view, _, name = rest.partition(":")
                bounds.setdefault(int(view), {})[name] = np.asarray(array, np.float64)
        self._bounds = dict(bounds)
