"""A cell of the gradient matrix: a derivative of a small image, compared with central differences.

It is a scene and a number theta that some of its parameters depend on. Its derivative is that of a weighted sum of
pixels. It is right if it is that of central differences at the same seeds, within 3 per cent or 4 standard errors, or
refused with a reason; anything else is wrong. Cells may ask for more than 3 per cent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, RenderError
from djpt.jit.types import Array4f, Float, TensorXf
from djpt.validation.gradcheck.check import judged, standard_error

__all__ = [
    "GUIDE",
    "MOST_SEEDS",
    "SEEDS",
    "Accuracy",
    "Cell",
    "Edit",
    "Node",
    "Outcome",
    "Scene",
    "camera_above",
    "moved",
]

SIZE = 12
COLUMN = np.linspace(-1, 1, SIZE)
WEIGHTS = np.broadcast_to(1 + 1.2 * COLUMN[None, :, None] - 0.6 * COLUMN[:, None, None], (SIZE, SIZE, 3))
"""The weights of pixels, with one slope all over: the derivative of what moves from pixel to pixel doesn't cancel."""

Node = dict[str, Any]
Edit = Callable[[Any, Float], None]
"""Makes parameters depend on theta."""

SEEDS, MOST_SEEDS = 4, 64
"""The number of seeds to start with, and the largest one of derivatives."""

DIFFERENCES = 8
"""The largest number of seeds of differences, which cost less, as a multiple of that of derivatives."""

GUIDE = {"proj_seed_spp": 512, "octree_max_depth": 7}
"""The settings of guides for so few pixels: derivatives are right with any."""

BLUR = 3
"""The standard deviation of blurs in pixels."""

CRITICAL = 4.0
"""The deviate up to which a derivative is right."""

SUSPECT = 2.0
"""The deviate above which more seeds are needed, as few of them can't tell."""


def camera_above(**more: Any) -> Node:
    """A camera that looks down at an angle."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    place = T().look_at([1.5, -2.5, 6], [0, 0, 0.3], [0, 1, 0])
    return {"type": "perspective", "fov": 38, "to_world": place, "film": film, **more}


@dataclass(frozen=True)
class Outcome:
    """What was found of a cell."""

    verdict: str
    """``right``, ``refused``, ``noisy`` (it may be right, but the error is too large to tell) or ``wrong``."""
    found: float = np.nan
    expected: float = np.nan
    error: float = np.nan
    """The standard error of the difference of the two."""
    z: float = np.nan
    """The difference as a normal deviate, by Welch's test: a few seeds tell of their own error only roughly."""
    reason: str = ""
    """Why it is refused."""


@dataclass(frozen=True)
class Accuracy:
    """What is asked of a derivative."""

    close: float = 0.03
    """The relative difference up to which it is right whatever its noise."""
    precise: float = 0.03
    """The standard error at which no more seeds are needed, relative to the derivative, ..."""
    nothing: float = 1e-3
    """... or to the sum of pixels."""


@dataclass(frozen=True)
class Cell:
    """A derivative."""

    group: str
    name: str
    nodes: Callable[[], Node]
    """The scene's entries, but for the camera."""
    edit: Edit
    integrator: Node
    step: float = 0.08
    spp: int = 2048
    """0: those of `settings`."""
    spp_difference: int = 0
    """Of differences, whose images take less time; 0: `spp`."""
    camera: Callable[[], Node] = camera_above
    weights: NDArray[np.float64] = field(default_factory=lambda: WEIGHTS, repr=False)
    """One for each number of the image, ..."""
    picture: float = 0.0
    """... unless this is a theta: then weights are the blurred residual against a picture of the scene with it."""
    settings: Mapping[str, int] = field(default_factory=lambda: GUIDE)
    """Attributes of the integrator."""
    accuracy: Accuracy = Accuracy()
    seeds: int = MOST_SEEDS
    """The most seeds of derivatives."""

    @property
    def label(self) -> str:
        """A name among all cells."""
        return f"{self.group}: {self.name}, {self.integrator['type']}"

    def measured(self, most: int | None = None, differences: int = DIFFERENCES) -> Outcome:
        """The comparison of the derivative, of at most so many seeds, with differences, of `differences` as many."""
        most = most or self.seeds
        try:
            scene = Scene(self)
            found = [scene.forward(2 * seed + 101) for seed in range(SEEDS)]
            expected = [scene.difference(seed) for seed in range(SEEDS)]
            brightness = scene.brightness()
            while True:
                pair = np.array(found), np.array(expected)
                errors = [standard_error(values) for values in pair]
                error = float(np.hypot(*errors))
                wanted = float(np.mean(expected))
                precise = error <= max(self.accuracy.precise * abs(wanted), self.accuracy.nothing * brightness)
                difference = abs(float(np.mean(found)) - wanted)
                z = judged(self.label, *pair, CRITICAL, paired=False).z
                close = difference <= self.accuracy.close * abs(wanted)
                more = len(found) < most, len(expected) < differences * most
                # The side with the larger error first; if that may have no more seeds, the other one can't help much.
                noisier = int(errors[1] > errors[0])
                exhausted = not more[noisier] and errors[1 - noisier] < 0.5 * errors[noisier]
                if (precise and (close or abs(z) <= SUSPECT)) or exhausted or not any(more):
                    break
                if more[0] and (noisier == 0 or not more[1]):
                    found += [scene.forward(2 * seed + 101) for seed in range(len(found), 2 * len(found))]
                else:
                    expected += [scene.difference(seed) for seed in range(len(expected), 2 * len(expected))]
        except (ParameterError, RenderError) as refusal:
            return Outcome("refused", reason=str(refusal))
        right = close or abs(z) <= CRITICAL
        return Outcome(("right" if precise else "noisy") if right else "wrong", float(np.mean(found)), wanted, error, z)


def moved(key: str, motion: Callable[[Float], Any]) -> Edit:
    """A transform, the vertices of a mesh, or the control points of curves, whose radii stay, after a motion."""

    def edit(params: Any, theta: Float) -> None:
        node = key.rpartition(".")[0]
        if key in params:
            params[key] = motion(theta) @ djpt.Transform4f(params[key])
        elif f"{node}.vertex_positions" in params:
            points = dr.unravel(djpt.Point3f, Float(params[f"{node}.vertex_positions"]))
            params[f"{node}.vertex_positions"] = dr.ravel(motion(theta).transform_point(points))
        elif f"{node}.control_points" in params:
            points = dr.unravel(Array4f, Float(params[f"{node}.control_points"]))
            p = motion(theta).transform_point(djpt.Point3f(points.x, points.y, points.z))
            params[f"{node}.control_points"] = dr.ravel(Array4f(p.x, p.y, p.z, points.w))
        else:
            raise RenderError(f"'{node}' has no place that can be differentiated")

    return edit


class Scene:
    """The scene of a cell, whose parameters are functions of theta."""

    def __init__(self, cell: Cell) -> None:
        nodes = {"type": "scene", "integrator": cell.integrator, "sensor": cell.camera(), **cell.nodes()}
        self.cell, self.scene = cell, djpt.load_dict(nodes, optimize=False)
        for name, value in cell.settings.items():
            if cell.integrator["type"].endswith("projective"):
                setattr(self.scene.integrator(), name, value)
        self.params = djpt.traverse(self.scene)
        self.start = Start(self.params)
        # The same light, by kernels that compile faster.
        plain = {"type": "volpath" if "vol" in cell.integrator["type"] else "path"}
        self.plain = djpt.load_dict({**plain, "max_depth": cell.integrator.get("max_depth", 2)})
        self.weights = self.residual(cell.picture) if cell.picture else cell.weights

    def image(self, theta: Float, seed: int, integrator: Any = None) -> Any:
        """The image, by the cell's integrator or another one."""
        self.cell.edit(self.start, theta)
        self.params.update()
        spp = self.cell.spp if integrator is None else self.cell.spp_difference or self.cell.spp
        return djpt.render(self.scene, self.params, integrator=integrator, spp=spp, seed=seed)

    def loss(self, theta: Float, seed: int, integrator: Any = None) -> Any:
        """The weighted sum of pixels."""
        return dr.sum(self.image(theta, seed, integrator) * TensorXf(self.weights.astype(np.float32)), axis=None)

    def forward(self, seed: int) -> float:
        """The derivative by forward mode."""
        return float(np.array(dr.forward_to(self.loss(moving(), seed))).ravel()[0])

    def forward_image(self, seed: int) -> NDArray[np.float64]:
        """The derivatives of all pixels by forward mode."""
        return np.array(dr.forward_to(self.image(moving(), seed)), np.float64)

    def difference(self, seed: int) -> float:
        """The derivative by central differences with two steps, and Richardson's extrapolation."""
        h = self.cell.step
        at = {x: float(np.array(self.loss(Float(x), seed, self.plain)).ravel()[0]) for x in (-h, -h / 2, h / 2, h)}
        return (8 * (at[h / 2] - at[-h / 2]) - (at[h] - at[-h])) / (6 * h)

    def difference_image(self, seed: int, step: float) -> NDArray[np.float64]:
        """The derivatives of all pixels by central differences."""
        behind, ahead = (np.array(self.image(Float(x), seed, self.plain), np.float64) for x in (-step, step))
        found: NDArray[np.float64] = (ahead - behind) / (2 * step)
        return found

    def residual(self, picture: float) -> NDArray[np.float64]:
        """The difference of a picture of the scene with a theta to one with 0, blurred; its mean size is 1."""
        here, there = (np.array(self.image(Float(x), 77, self.plain), np.float64) for x in (0.0, picture))
        found = blurred(there - here)
        return found / np.mean(np.abs(found))

    def brightness(self) -> float:
        """The loss itself."""
        return float(np.array(self.loss(Float(0), 1, self.plain)).ravel()[0])


def blurred(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """An image seen out of focus: convolved with a Gaussian whose standard deviation is `BLUR` pixels."""
    x = np.arange(-3 * BLUR, 3 * BLUR + 1)
    kernel = np.exp(-0.5 * (x / BLUR) ** 2)
    padded = np.pad(image, [(3 * BLUR,) * 2] * 2 + [(0, 0)], mode="edge")
    for axis in (0, 1):
        padded = np.apply_along_axis(np.convolve, axis, padded, kernel / kernel.sum(), "valid")
    return padded


def moving() -> Float:
    """A theta of 0 that changes at the rate 1."""
    theta = Float(0)
    dr.enable_grad(theta)
    dr.set_grad(theta, 1.0)
    return theta


class Start(Mapping[str, Any]):
    """The parameters as they were at first, for reading; those of the scene, for writing."""

    def __init__(self, params: Any) -> None:
        self._params, self._first = params, {key: params[key] for key in params}

    def __getitem__(self, key: str) -> Any:
        return self._first[key]

    def __setitem__(self, key: str, value: Any) -> None:
        self._params[key] = value

    def __iter__(self) -> Iterator[str]:
        return iter(self._first)

    def __len__(self) -> int:
        return len(self._first)
