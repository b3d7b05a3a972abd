"""The pose of the nodes of a glTF file at a time of an animation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.models.gltf_file import GltfFile

__all__ = ["animated"]

WIDTHS = {"translation": 3, "rotation": 4, "scale": 3, "weights": None}

Values = NDArray[np.float64]


def animated(file: GltfFile, time: float, number: int) -> dict[int, dict[str, Values]]:
    """What an animation makes of nodes at `time` seconds: values by node and by name (``translation``, ..).

    Before its first key and after its last one a value stays as it is there.

    Raises:
        SceneError: there is no such animation, or it is damaged.
    """
    if not math.isfinite(time):
        raise file.error(f"'time' must be a number of seconds, found {time!r}")
    animation = file.at("animations", number)
    channels, samplers = animation.get("channels"), animation.get("samplers")
    if not isinstance(channels, list) or not isinstance(samplers, list):
        raise file.error(f"animations[{number}] needs 'channels' and 'samplers'")
    result: dict[int, dict[str, Values]] = {}
    for channel in channels:
        target = channel.get("target") if isinstance(channel, dict) else None
        sampler = channel.get("sampler") if isinstance(channel, dict) else None
        if not isinstance(target, dict) or not isinstance(sampler, int) or not 0 <= sampler < len(samplers):
            raise file.error(f"animations[{number}] has a channel without target or sampler")
        node, path = target.get("node"), target.get("path")
        if not isinstance(node, int) or path not in WIDTHS or not isinstance(samplers[sampler], dict):
            continue
        result.setdefault(node, {})[path] = value_at(file, samplers[sampler], path, time, f"animations[{number}]")
    for node, pose in result.items():  # what isn't animated stays
        described = file.at("nodes", node)
        if "matrix" in described:
            raise file.error(f"nodes[{node}] has a matrix and is animated by {', '.join(pose)}")
    return result


def value_at(file: GltfFile, sampler: dict[str, Any], path: str, time: float, where: str) -> Values:
    """The value of a sampler at a time."""
    times = file.accessor(sampler.get("input"), 1)[:, 0].astype(np.float64)
    values = file.accessor(sampler.get("output"), WIDTHS[path]).astype(np.float64)
    mode = sampler.get("interpolation", "LINEAR")
    count = len(times)
    per_key = 3 if mode == "CUBICSPLINE" else 1
    if not count or len(values) % (count * per_key) or not len(values):
        raise file.error(f"{where}: {len(values)} values for {count} times")
    keys = values.reshape(count, per_key, -1)
    middle = 1 if per_key == 3 else 0
    after = int(np.searchsorted(times, time, side="right"))
    if after == 0 or after == count:
        return keys[0 if after == 0 else -1, middle]
    before, step = after - 1, float(times[after] - times[after - 1])
    share = (time - float(times[before])) / step if step > 0 else 0.0
    a, b = keys[before, middle], keys[after, middle]
    if mode == "STEP":
        return a
    if mode == "CUBICSPLINE":
        s, s2, s3 = share, share**2, share**3
        out, into = keys[before, 2] * step, keys[after, 0] * step
        found = (2 * s3 - 3 * s2 + 1) * a + (s3 - 2 * s2 + s) * out + (3 * s2 - 2 * s3) * b + (s3 - s2) * into
    elif path == "rotation":
        found = slerp(a, b, share)
    else:
        found = (1 - share) * a + share * b
    return found / (np.linalg.norm(found) or 1.0) if path == "rotation" else found


def slerp(a: Values, b: Values, share: float) -> Values:
    """The rotation on the shorter way from one unit quaternion to another."""
    cosine = float(np.dot(a, b))
    if cosine < 0:
        b, cosine = -b, -cosine
    if cosine > 0.9995:
        return (1 - share) * a + share * b
    angle = math.acos(min(cosine, 1.0))
    result: Values = (math.sin((1 - share) * angle) * a + math.sin(share * angle) * b) / math.sin(angle)
    return result
