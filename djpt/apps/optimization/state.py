"""The state of a search in a file, from which it can be continued."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import drjit as dr
import numpy as np

from djpt.apps.optimization.curvature import Curvatures
from djpt.apps.optimization.variables import Variable
from djpt.core.files import as_path, open_regular, writing
from djpt.errors import FileError

__all__ = ["load_state", "save_state"]

KIND = "djpt search 1"


def save_state(
    path: str | os.PathLike[str],
    iteration: int,
    losses: list[float],
    sums: Mapping[str, Any],
    optimizer: Any,
    variables: Mapping[str, Variable],
    curvatures: Curvatures | None = None,
) -> None:
    """Write a search: its variables, its optimiser's moments, its losses, the curvatures that it has measured."""
    arrays: dict[str, Any] = {}
    for name in variables:
        arrays[f"x:{name}"] = np.array(optimizer[name])
        arrays[f"sum:{name}"] = np.array(sums[name], np.float64)
        for i, moment in enumerate(moments(optimizer, name)):
            if moment is not None:
                arrays[f"moment{i}:{name}"] = np.array(moment)
    for key, array in (curvatures.arrays() if curvatures is not None else {}).items():
        arrays[f"curvature:{key}"] = array
    header = {"kind": KIND, "iteration": iteration, "losses": losses, "optimizer": type(optimizer).__name__}
    with writing(as_path(path)) as temporary, temporary.open("wb") as file:
        np.savez(file, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)


def load_state(
    path: str | os.PathLike[str],
    optimizer: Any,
    variables: Mapping[str, Variable],
    curvatures: Curvatures | None = None,
) -> tuple[int, list[float], dict[str, Any]]:
    """Load a search into an optimiser: returns the next iteration, the losses, the sums of parameters.

    Raises:
        FileError: The file belongs to another search, or is damaged.
    """
    try:
        with open_regular(path) as file, np.load(file, allow_pickle=False) as stored:
            header = json.loads(bytes(stored["header"]).decode())
            arrays = {name: stored[name] for name in stored.files if name != "header"}
        names = {name[2:] for name in arrays if name.startswith("x:")}
        if header["kind"] != KIND or names != set(variables) or header["optimizer"] != type(optimizer).__name__:
            raise FileError(
                f"'{path}' holds another optimisation: of {', '.join(sorted(names))} by {header['optimizer']}"
            )
        for name, v in variables.items():
            optimizer[name] = v.type(arrays[f"x:{name}"])
            kept = sorted(key for key in arrays if key.startswith("moment") and key.partition(":")[2] == name)
            restore(optimizer, name, [arrays[key] for key in kept])
        if curvatures is not None:
            known = {key.partition(":")[2]: arrays[key] for key in arrays if key.startswith("curvature:")}
            curvatures.restore(known)
        return int(header["iteration"]), list(header["losses"]), {name: arrays[f"sum:{name}"] for name in variables}
    except FileError:
        raise
    except Exception as error:  # whatever a damaged archive raises
        raise FileError(f"can't continue from '{path}': {error}") from None


def moments(optimizer: Any, name: str) -> list[Any]:
    """The state of a variable in an optimiser of `drjit.opt`, as numbers and arrays; None where there is none."""
    extra = optimizer.state[name][3]
    return list(extra) if isinstance(extra, tuple) else [extra]


def restore(optimizer: Any, name: str, values: list[Any]) -> None:
    """Restore the state of an optimiser, in the types of its current values."""
    value, promoted, rate, extra = optimizer.state[name]
    now = list(extra) if isinstance(extra, tuple) else [extra]
    found = iter(values)
    new = [None if entry is None else typed(next(found), entry) for entry in now]
    optimizer.state[name] = value, promoted, rate, tuple(new) if isinstance(extra, tuple) else new[0]


def typed(value: Any, like: Any) -> Any:
    """Numbers from a file, in the type of the array or number that they replace."""
    return type(like)(value) if dr.is_array_v(like) else type(like)(value.item())
