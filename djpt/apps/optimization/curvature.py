"""The curvature of a search: one bound for each view, remeasured periodically."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["Curvatures"]

Doubles = npt.NDArray[np.float64]

USES = 8
"""The number of uses of a view's curvature before it is remeasured: derivatives change with the parameters."""


class Curvatures:
    """Bounds on the curvature of the losses of all views.

    Args:
        views: the numbers of the sensors.
        measured: returns the bounds of a view by the names of the variables; called with the view and the number of the
            measurement.
    """

    def __init__(self, views: Sequence[int], measured: Callable[[int, int], Mapping[str, Doubles]]) -> None:
        self._measured, self._measurements = measured, 0
        self._bounds: dict[int, Mapping[str, Doubles]] = {}
        self._uses = dict.fromkeys(views, 0)

    def forget(self) -> None:
        """Remeasure all views before they are next used."""
        self._bounds = {}
        self._uses = dict.fromkeys(self._uses, 0)

    def of(self, views: Sequence[int]) -> tuple[dict[str, Doubles], bool]:
        """A bound on the curvature of the mean loss of as many views as these; True if one of these was measured now.

        It is the mean of the largest bounds of single views, for each entry: entries that some views don't
        show at all then don't change too much when other views are used.
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
        """The complete state, to be stored in a file."""
        found: dict[str, npt.NDArray[np.generic]] = {"measurements": np.array(self._measurements)}
        found |= {f"uses:{view}": np.array(uses) for view, uses in self._uses.items()}
        for view, bounds in self._bounds.items():
            found |= {f"bound:{view}:{name}": bound for name, bound in bounds.items()}
        return found

    def restore(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Restore the state that `arrays` returned."""
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
