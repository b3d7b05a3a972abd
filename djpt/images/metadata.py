"""What a bitmap says about itself: names with values."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.numeric import describe
from djpt.core.transforms import ScalarTransform4f, matrix_of
from djpt.errors import SceneError

__all__ = ["Metadata"]


class Metadata(MutableMapping[str, Any]):
    """Names with texts, numbers, truth values, vectors of three numbers, or transforms.

    Lists of three numbers become vectors (`drjit.scalar.Array3f64`), 4 x 4 and 3 x 3 matrices `ScalarTransform4f`,
    as they come back from an exr file.

    Raises:
        SceneError: another kind of value is assigned.
    """

    def __init__(self, values: Any = ()) -> None:
        self._values: dict[str, Any] = {}
        self.update(values)

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __setitem__(self, name: str, value: Any) -> None:
        self._values[name] = normal(name, value)

    def __delitem__(self, name: str) -> None:
        del self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Metadata):
            return NotImplemented
        return self.numbers().keys() == other.numbers().keys() and all(
            np.array_equal(value, other.numbers()[name]) for name, value in self.numbers().items()
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Metadata({self._values!r})"

    def has_property(self, name: str) -> bool:
        """Whether there is a value of the name."""
        return name in self._values

    def numbers(self) -> dict[str, Any]:
        """The values, vectors and transforms as NumPy arrays."""
        return {
            name: value if is_plain(value) else np.asarray(matrix_of(value)) for name, value in self._values.items()
        }


def is_plain(value: Any) -> bool:
    """Whether a value is a text, a number or a truth value."""
    return isinstance(value, (str, bool, int, float))


def normal(name: str, value: Any) -> Any:
    """The form in which a value is kept."""
    if isinstance(value, (np.integer, np.floating)):
        value = value.item()
    if is_plain(value) or isinstance(value, ScalarTransform4f):
        return value
    try:
        array = np.array(matrix_of(value), np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape == (3,):
        return dr.scalar.Array3f64(*array.tolist())
    if array.shape in ((3, 3), (4, 4)):
        matrix = np.eye(4)
        matrix[: len(array), : len(array)] = array
        return ScalarTransform4f(matrix) if np.array_equal(matrix[3], (0, 0, 0, 1)) else dr.scalar.Matrix4f64(matrix)
    raise SceneError(
        f"metadata '{name}': must be a text, a number, three numbers or a 4x4 matrix, found {describe(value)}"
    )
