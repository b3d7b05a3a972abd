"""Small scenes drawn at random in which a body or the camera moves: cells of the gradient matrix that nobody chose.

A seed draws

* one to three bodies of nine kinds (analytic shapes, a smooth mesh, a faceted one), each with a place, a turn, a size
  and a material of its own, which overlap, touch or cut the floor as it happens;
* mostly a floor, at the height of the bodies' lowest centres or a little below;
* one light of six kinds, and paths of one or two bounces;
* a camera in any direction from above, with 16 x 16 pixels and smooth weights;
* what moves, the first body or the camera: along a random direction while it turns about its centre.

A quarter of the scenes may have surfaces without roughness (mirrors, glass, plastic, masks).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float
from tests.gradients.cells import Accuracy, Cell, Node, moved
from tests.silhouettes.cases import sky
from tests.silhouettes.test_projective import globe, octahedron

__all__ = ["random_cell"]

SIZE = 16
ACCURACY = Accuracy(close=0.01, precise=0.01, nothing=5e-4)

STEP = 0.025
"""Of differences: about a tenth of a pixel."""

LOOKED_AT = (0.03, 0.05, 0.4)
SHAPES = ("sphere", "cube", "cylinder", "disk", "rectangle", "cone", "torus", "globe", "octahedron")
ROUGH = ("diffuse", "diffuse", "two-sided", "checkerboard", "roughconductor", "roughplastic", "principled")
SMOOTH = ("conductor", "dielectric", "plastic", "mask")
LIGHTS = ("sky", "map", "point", "sun", "lamp", "ball")

Random = np.random.Generator


def random_cell(seed: int) -> Cell:
    """The cell of a seed."""
    rng = np.random.default_rng(seed)
    depth = int(rng.choice([2, 2, 3]))
    smooth = bool(rng.random() < 0.25)
    plain = depth == 2 and not smooth and bool(rng.random() < 0.5)
    drawn = [body(rng, f"body{i}", smooth) for i in range(int(rng.integers(1, 4)))]
    with_floor, height, paint = bool(rng.random() < 0.8), float(rng.choice([0, 0, -0.3])), diffuse(rng)
    name_of_light = str(rng.choice(LIGHTS))
    shining, seen_from, weights = light(rng, name_of_light), camera(rng), waves(rng)
    moves = str(rng.choice(["sensor", "body0", "body0"]))
    centre = np.array(seen_from["to_world"].matrix)[:3, 3] if moves == "sensor" else drawn[0][1]
    motion = along_and_about(rng, centre)

    def nodes() -> Node:
        found = {f"body{i}": make() for i, (_, _, make) in enumerate(drawn)}
        if with_floor:
            place = T().translate([0, 0, height]).scale(6)
            found["floor"] = {"type": "rectangle", "to_world": place, "bsdf": paint}
        return {**found, "light": shining}

    told = ", ".join(name for name, _, _ in drawn)
    return Cell(
        "a random scene",
        f"{seed} ({moves} moves, {told}{', floor' * with_floor}, {name_of_light})",
        nodes,
        moved(f"{moves}.to_world", motion),
        {"type": "direct_projective"} if plain else {"type": "prb_projective", "max_depth": depth},
        step=STEP,
        spp=256,
        spp_difference=4096,
        camera=lambda: seen_from,
        weights=weights,
        settings={},
        accuracy=ACCURACY,
    )


def body(rng: Random, key: str, smooth: bool) -> tuple[str, NDArray[np.float64], Callable[[], Any]]:
    """A body: its name, its centre, and what makes its node."""
    kind, surface = str(rng.choice(SHAPES)), str(rng.choice(ROUGH + SMOOTH * smooth))
    centre = rng.uniform([-1, -1, 0], [1, 1, 1])
    size, turn = float(rng.uniform(0.35, 0.8)), T().rotate(direction(rng), float(rng.uniform(0, 360)))
    stretch = rng.uniform(0.7, 1.3, 3)
    bsdf = material(rng, surface)
    name = f"{kind} of {surface}"
    if kind in ("globe", "octahedron"):
        place = np.array((T().translate(centre.tolist()) @ turn @ T().scale((size * stretch).tolist())).matrix)
        return name, centre, lambda: mesh(key, kind == "octahedron", place, bsdf)
    if kind in ("sphere", "cylinder", "cone", "torus"):  # these may not be stretched
        stretch = np.ones(3)
    node = {
        "type": kind,
        "to_world": T().translate(centre.tolist()) @ turn @ T().scale((size * stretch).tolist()),
        "bsdf": bsdf,
    }
    if kind == "torus":
        node.update(major=0.7, minor=0.25)
    return name, centre, lambda: node


def mesh(key: str, facets: bool, place: NDArray[np.float64], bsdf: Node) -> Any:
    """An octahedron with flat faces, or a smooth ball of triangles, after an affine map."""
    data = (octahedron((0, 0, 0), 1) if facets else globe(10, 20)).data()
    points = (data.positions @ place[:3, :3].T + place[:3, 3]).astype(np.float32)
    found = djpt.Mesh(key, points, data.indices, props={"bsdf": bsdf, "face_normals": facets})
    if not facets:
        found.recompute_vertex_normals()
    return found


def material(rng: Random, name: str) -> Node:
    """A material by its name, with numbers at random."""
    if name == "diffuse":
        return diffuse(rng)
    if name in ("two-sided", "mask"):
        more = {"opacity": float(rng.uniform(0.3, 0.8))} if name == "mask" else {}
        return {"type": name.replace("-", ""), **more, "nested": diffuse(rng)}
    if name == "checkerboard":
        fields = T().scale([int(rng.integers(2, 6)), int(rng.integers(2, 6)), 1])
        return {"type": "diffuse", "reflectance": {"type": name, "to_uv": fields, "color0": 0.2, "color1": 0.8}}
    if name == "roughconductor":
        return {"type": name, "alpha": float(rng.uniform(0.15, 0.5))}
    if name == "roughplastic":
        return {"type": name, "alpha": float(rng.uniform(0.15, 0.4)), "diffuse_reflectance": colour(rng)}
    if name == "principled":
        roughness, metallic = rng.uniform(0.3, 0.9), rng.uniform(0, 1)
        return {"type": name, "roughness": float(roughness), "metallic": float(metallic), "base_color": colour(rng)}
    return {"type": name}


def light(rng: Random, name: str) -> Node:
    """A light by its name, from above."""
    place = rng.uniform([-2.5, -2.5, 2.5], [2.5, 2.5, 4.5])
    shining = {"emitter": {"type": "area", "radiance": 12.0}}
    facing = T().look_at(place.tolist(), [0, 0, 0], [0.1, 1, 0]).scale(0.6)
    found: dict[str, Node] = {
        "sky": {"type": "constant", "radiance": 1.0},
        "map": sky(),
        "point": {"type": "point", "position": place.tolist(), "intensity": 30.0},
        "sun": {"type": "directional", "direction": (-place).tolist(), "irradiance": 3.0},
        "lamp": {"type": "rectangle", "to_world": facing, **shining},
        "ball": {"type": "sphere", "center": place.tolist(), "radius": 0.5, **shining},
    }
    return found[name]


def camera(rng: Random) -> Node:
    """A camera that looks at the middle of the scene from above."""
    origin = np.array(direction(rng))
    origin[2] = abs(origin[2]) + 0.3
    origin *= rng.uniform(5, 7) / np.linalg.norm(origin)
    place = T().look_at(origin.tolist(), list(LOOKED_AT), [0, 0.1, 1])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    return {"type": "perspective", "fov": float(rng.uniform(18, 32)), "to_world": place, "film": film}


def waves(rng: Random) -> NDArray[np.float64]:
    """Weights of pixels: for each colour a wave of at most a period across the image, and a constant."""
    along = np.linspace(-3, 3, SIZE)
    x, y = rng.uniform(-1, 1, 2)
    phases = (x * along)[None, :, None] + (y * along)[:, None, None] + rng.uniform(0, 2 * np.pi, 3)
    found: NDArray[np.float64] = 0.5 + np.cos(phases)
    return found


def along_and_about(rng: Random, centre: NDArray[np.float64]) -> Callable[[Float], Any]:
    """A motion along a random direction, with a turn about a random axis through a point."""
    along, axis, degrees = np.array(direction(rng)), direction(rng), float(rng.uniform(-10, 10))

    def motion(theta: Float) -> Any:
        to = djpt.Transform4f().translate([float(c) + float(d) * theta for c, d in zip(centre, along, strict=True)])
        return to.rotate(axis, degrees * theta).translate((-centre).tolist())

    return motion


def direction(rng: Random) -> list[float]:
    """A unit vector, uniform on the sphere."""
    vector = rng.normal(size=3)
    return [float(x) for x in vector / np.linalg.norm(vector)]


def colour(rng: Random) -> Node:
    return {"type": "rgb", "value": rng.uniform(0.15, 0.9, 3).tolist()}


def diffuse(rng: Random) -> Node:
    return {"type": "diffuse", "reflectance": colour(rng)}
