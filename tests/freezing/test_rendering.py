"""Functions frozen by `dr.freeze` that render: the same bits as without, with other parameters and seeds."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest
from drjit.opt import Adam

import djpt
from djpt.jit.frozen import SHARED
from djpt.jit.llvm.calls import address_of
from djpt.jit.types import Color3f, TensorXf, UInt32
from tests.kit.processes import run_python
from tests.kit.renders import box, pixels

RED = "red.reflectance.value"
AREAS: dict[str, Any] = {"type": "aov", "aovs": "depth:depth,n:sh_normal", "colour": {"type": "path"}}


def with_mesh(scene: dict[str, Any]) -> None:
    """Add a mesh to a scene."""
    mesh = djpt.Mesh("tetrahedron", 4, 4)
    corners = np.array([[-0.3, -0.3, 0], [0.3, -0.3, 0], [0, 0.3, 0], [0, 0, 0.4]], np.float32)
    params = djpt.traverse(mesh)
    params["vertex_positions"] = corners.ravel()
    params["faces"] = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.uint32).ravel()
    params.update()
    scene["tetrahedron"] = mesh


def with_fog(scene: dict[str, Any]) -> None:
    """Fill the room, and where the camera stands, with fog that has a denser part."""
    density = {"type": "gridvolume", "data": np.linspace(0.2, 2, 8, dtype=np.float32).reshape(2, 2, 2)}
    smoke = {"type": "heterogeneous", "albedo": 0.8, "sigma_t": density}
    scene["fog"] = {"type": "homogeneous", "albedo": 0.9, "sigma_t": 0.2}
    scene["sensor"]["medium"] = {"type": "ref", "id": "fog"}
    scene["smoke"] = {
        "type": "cube",
        "to_world": djpt.ScalarTransform4f().scale(0.4),
        "bsdf": {"type": "null"},
        "interior": smoke,
        "exterior": {"type": "ref", "id": "fog"},
    }


SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "sums in registers": lambda: box(8),
    "sums by calls": lambda: box(8, "gaussian"),
    "sums per tap": lambda: box(8, "lanczos"),
    "a mesh": lambda: box(8, "gaussian", edit=with_mesh),
    "several channels": lambda: box(8, "gaussian", AREAS),
    "light paths": lambda: box(8, "gaussian", {"type": "ptracer"}),
    "both ends": lambda: box(8, "gaussian", {"type": "bdpt"}),
    "fog": lambda: box(8, "gaussian", {"type": "volpath", "max_depth": 4}, with_fog),
}


def image(scene: djpt.Scene, seed: UInt32) -> TensorXf:
    return djpt.render(scene, spp=2, seed=seed)


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", SCENES)
def test_a_frozen_rendering_gives_the_same_bits(name: str) -> None:
    scene = djpt.load_dict(SCENES[name]())
    params, frozen = djpt.traverse(scene), dr.freeze(image)
    seen = []
    for k in range(4):
        params[RED] = Color3f(0.2 + 0.2 * k, 0.1, 0.1)
        params.update()
        found, expected = pixels(frozen(scene, UInt32(k))), pixels(image(scene, UInt32(k)))
        np.testing.assert_array_equal(found, expected)
        seen.append(found)
    assert not np.array_equal(seen[2], seen[3])
    assert frozen.n_recordings == 2, "the second one finds out which arrays have other values each time"


def test_no_two_arrays_share_memory() -> None:
    """A call of a frozen function would leave one of them, so that the next one finds other inputs."""
    scene = djpt.load_dict(SCENES["a mesh"]())
    image(scene, UInt32(0))
    arrays = [leaf for entry in scene.held[1:] for leaf in leaves(entry) if leaf.state == dr.VarState.Evaluated]
    address = {leaf.index: address_of(leaf) for leaf in arrays}
    assert len(SHARED) >= 2 and len(set(address.values())) == len(address)


def leaves(value: Any) -> list[Any]:
    """The arrays of numbers that an array of vectors or a tensor consists of."""
    if dr.is_tensor_v(value):
        return [value.array]
    return [value] if dr.depth_v(value) == 1 else [leaf for part in value for leaf in leaves(part)]


@pytest.mark.parametrize("schedule", ["machine", "wave"])
def test_every_schedule_can_be_frozen(schedule: str) -> None:
    scene = djpt.load_dict(box(8, edit=with_mesh))
    frozen = dr.freeze(lambda scene, seed: djpt.render(scene, spp=2, seed=seed, schedule=schedule))
    for k in range(3):
        expected = djpt.render(scene, spp=2, seed=k, schedule=schedule)
        np.testing.assert_array_equal(pixels(frozen(scene, UInt32(k))), pixels(expected))


def test_passes_can_be_frozen() -> None:
    scene = djpt.load_dict(box(8, "gaussian"))
    frozen = dr.freeze(lambda scene, seed: djpt.render(scene, spp=4, seed=seed, pass_spp=1))
    for k in range(3):
        np.testing.assert_array_equal(pixels(frozen(scene, UInt32(k))), pixels(djpt.render(scene, spp=4, seed=k)))


@pytest.mark.parametrize("compensated", [False, True])
def test_an_environment_map_can_be_edited_in_a_frozen_function(compensated: bool) -> None:
    """Kernels compute its tables, in single precision: roundings differ."""
    rng = np.random.default_rng(3)
    first = rng.uniform(0, 1, (5, 7, 3)).astype(np.float32)
    sky = {"type": "envmap", "data": first, "mis_compensation": compensated}
    sensor = box(8)["sensor"]
    ball = {"type": "sphere", "center": [0, 0, 0], "radius": 0.5, "bsdf": {"type": "diffuse"}}
    parts = {"type": "scene", "integrator": {"type": "path", "max_depth": 3}, "sensor": sensor, "ball": ball}

    def edited(scene: djpt.Scene, data: TensorXf, seed: UInt32) -> TensorXf:
        params = djpt.traverse(scene)
        params["sky.data"] = data
        params.update()
        return djpt.render(scene, spp=4, seed=seed)

    one, other = (djpt.load_dict({**parts, "sky": sky}) for _ in range(2))
    frozen = dr.freeze(edited)
    for k in range(4):
        # The last map is black but for a texel, and directions to it are sampled all the same.
        texels = rng.uniform(0, 1, (5, 7, 3)) if k < 3 else np.eye(35)[17].reshape(5, 7, 1) * np.ones(3)
        data = np.concatenate([texels[:, -1:], texels, texels[:, :1]], axis=1).astype(np.float32)
        found, expected = (
            pixels(run(scene, TensorXf(data), UInt32(k))) for run, scene in ((frozen, one), (edited, other))
        )
        assert expected.mean() > 0.001
        np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-4)


# ---- derivatives ---------------------------------------------------------------------------------


def reverse(scene: djpt.Scene, target: TensorXf, seed: UInt32) -> Any:
    """The loss; its gradient is left to the parameters."""
    params = djpt.traverse(scene)
    loss = dr.mean(dr.square(djpt.render(scene, params, spp=2, seed=seed) - target), axis=None)
    dr.backward(loss)
    return loss


FOGGY: dict[str, Any] = {"type": "prbvolpath", "max_depth": 4}
INTEGRATORS: dict[str, dict[str, Any]] = {"replay": {"type": "path"}, "plain AD": {"type": "direct"}, "fog": FOGGY}


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_an_optimisation_by_frozen_steps_gives_the_same_values(name: str, rfilter: str) -> None:
    def run(step: Callable[..., Any]) -> list[list[float]]:
        scene = djpt.load_dict(box(8, rfilter, INTEGRATORS[name], with_fog if name == "fog" else None))
        target, params, found = djpt.render(scene, spp=16), djpt.traverse(scene), []
        optimizer = Adam(lr=0.02, params={RED: Color3f(0.4, 0.3, 0.6)})
        for k in range(5):
            params.update(optimizer)
            loss = step(scene, target, UInt32(k))
            optimizer.step()
            found.append([*np.array(optimizer[RED]).ravel().tolist(), loss.array[0]])
        return found

    frozen = dr.freeze(reverse)
    # Dr.Jit computes the loss in other kernels, with other roundings.
    np.testing.assert_allclose(run(frozen), run(reverse), rtol=1e-6)
    assert frozen.n_recordings == 2


def test_a_whole_step_with_its_optimiser_can_be_frozen() -> None:
    def step(scene: djpt.Scene, optimizer: Adam, target: TensorXf, seed: UInt32) -> Any:
        djpt.traverse(scene).update(optimizer)
        loss = reverse(scene, target, seed)
        optimizer.step()
        return loss

    def run(step: Callable[..., Any]) -> list[list[float]]:
        scene = djpt.load_dict(box(8))
        target, optimizer, found = djpt.render(scene, spp=16), Adam(lr=0.02), []
        optimizer[RED] = Color3f(0.4, 0.3, 0.6)
        for k in range(6):
            step(scene, optimizer, target, UInt32(k))
            found.append(np.array(optimizer[RED]).ravel().tolist())
        return found

    np.testing.assert_allclose(run(dr.freeze(step)), run(step), rtol=1e-6)


def test_forward_derivatives_can_be_frozen() -> None:
    def change(scene: djpt.Scene, seed: UInt32) -> TensorXf:
        params = djpt.traverse(scene)
        dr.enable_grad(params[RED])
        dr.set_grad(params[RED], Color3f(1, 0, 0))
        params.update()
        return dr.forward_to(djpt.render(scene, params, spp=2, seed=seed))

    scene, frozen = djpt.load_dict(box(8)), dr.freeze(change)
    for k in range(3):
        np.testing.assert_array_equal(pixels(frozen(scene, UInt32(k))), pixels(change(scene, UInt32(k))))


def test_gradients_that_are_lost_outside_cause_a_warning() -> None:
    scene = djpt.load_dict(box(8))
    params = djpt.traverse(scene)
    dr.enable_grad(params[RED])
    params.update()
    with pytest.warns(UserWarning, match=r"its result has none, so call dr\.backward"):
        dr.freeze(image)(scene, UInt32(0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dr.freeze(reverse)(scene, dr.zeros(TensorXf, (8, 8, 3)), UInt32(0))


# ---- what is an input, and what is structure -----------------------------------------------------


def test_another_count_of_samples_is_another_recording() -> None:
    scene = djpt.load_dict(box(8))
    frozen = dr.freeze(lambda scene, spp: djpt.render(scene, spp=spp))
    for spp in (2, 4, 2, 4):
        np.testing.assert_array_equal(pixels(frozen(scene, spp)), pixels(djpt.render(scene, spp=spp)))
    assert frozen.n_recordings == 2 + 1, "the film has another image now than at first"


def test_edits_of_structure_are_seen() -> None:
    scene = djpt.load_dict(box(8))
    params, frozen = djpt.traverse(scene), dr.freeze(image)
    for size, corner in ((8, 0.5), (4, 0.5), (4, 0.2)):
        params["sensor.film.size"] = (size, size)
        params["sensor.to_world"] = djpt.ScalarTransform4f().look_at([corner, 0, 3.9], [0, 0, 0], [0, 1, 0])
        params.update()
        found = pixels(frozen(scene, UInt32(0)))
        assert found.shape == (size, size, 3)
        np.testing.assert_array_equal(found, pixels(image(scene, UInt32(0))))


def test_a_frozen_function_serves_another_scene() -> None:
    frozen = dr.freeze(image)
    for colour in (0.1, 0.7):
        scene = djpt.load_dict(
            box(8, edit=lambda d, c=colour: d["green"]["reflectance"].update(value=[c, 0.2, 0.2]))  # type: ignore[misc]
        )
        np.testing.assert_array_equal(pixels(frozen(scene, UInt32(1))), pixels(image(scene, UInt32(1))))


def test_the_film_has_the_image_of_a_frozen_function() -> None:
    scene, frozen = djpt.load_dict(box(8)), dr.freeze(image)
    for k in range(3):
        found = frozen(scene, UInt32(k))
        np.testing.assert_array_equal(pixels(scene.sensors()[0].film().develop()), pixels(found))


def test_scenes_are_no_trees_of_arrays_elsewhere() -> None:
    """Dr.Jit looks into scenes when it calls frozen functions, and nowhere else."""
    scene = djpt.load_dict(box(8))
    assert not hasattr(scene, "DRJIT_STRUCT")
    assert not hasattr(djpt.traverse(scene), "DRJIT_STRUCT")


# ---- errors ----------------------------------------------------------------------------------------


def test_shapes_must_be_moved_outside() -> None:
    scene = djpt.load_dict(box(8))

    @dr.freeze
    def moved(scene: djpt.Scene, seed: UInt32) -> TensorXf:
        params = djpt.traverse(scene)
        params["floor.to_world"] = djpt.ScalarTransform4f().translate([0, 0.1, 0])
        params.update()
        return image(scene, seed)

    with pytest.raises(RuntimeError) as raised:
        moved(scene, UInt32(0))
    assert "floor: shapes can't be edited while dr.freeze records a function" in str(causes(raised.value))


MOVERS = ("small-box.vertex_positions", "light.to_world", "sensor.to_world")


def moving(integrator: str, mover: str) -> djpt.Scene:
    """A box in which something moves."""
    scene = djpt.load_dict(box(8, integrator={"type": integrator, "max_depth": 3}))
    params = djpt.traverse(scene)
    dr.enable_grad(params[mover])
    params.update()
    return scene


@pytest.mark.parametrize("integrator", ["direct_projective", "prb_projective"])
@pytest.mark.parametrize("mover", MOVERS)
def test_edges_that_move_are_refused(integrator: str, mover: str) -> None:
    """Dr.Jit would end the process, since memory of NumPy's is released while it records."""
    with pytest.raises(RuntimeError) as raised:
        dr.freeze(image)(moving(integrator, mover), UInt32(0))
    assert "a frozen function can't compute derivatives by motion" in str(causes(raised.value))


@pytest.mark.parametrize("integrator", ["path", "prb", "volpath", "ptracer", "bdpt"])
@pytest.mark.parametrize("mover", MOVERS)
def test_other_derivatives_by_motion_are_the_same_or_refused(integrator: str, mover: str) -> None:
    scene = moving(integrator, mover)
    value = djpt.traverse(scene)[mover]

    def gradient(scene: djpt.Scene, seed: UInt32) -> Any:
        dr.backward(dr.mean(image(scene, seed), axis=None))
        return dr.grad(value)

    try:
        found = dr.freeze(gradient)(scene, UInt32(0))
    except RuntimeError as error:
        assert isinstance(error.__cause__, djpt.errors.RenderError)
        return
    dr.set_grad(value, 0)
    assert dr.allclose(found, gradient(scene, UInt32(0)))


def test_a_seed_is_one_number() -> None:
    scene, frozen = djpt.load_dict(box(8)), dr.freeze(image)
    with pytest.raises(RuntimeError) as raised:
        frozen(scene, UInt32(1, 2))
    assert "'seed' must be one whole number, found 2" in str(causes(raised.value))


def causes(error: BaseException | None) -> list[str]:
    """The messages of an error and of its causes."""
    return [] if error is None else [str(error), *causes(error.__cause__)]


# ---- tables, meshes and memory ---------------------------------------------------------------------


def many_walls(scene: dict[str, Any]) -> None:
    """Add twenty spheres of different colours."""
    for k in range(20):
        colour = {"type": "rgb", "value": [0.9 - 0.04 * k, 0.1 + 0.04 * k, 0.5]}
        place = [0.09 * (k - 10), -0.8 + 0.08 * k, 0.3]
        scene[f"ball{k}"] = {"type": "sphere", "center": place, "radius": 0.05}
        scene[f"ball{k}"]["bsdf"] = {"type": "diffuse", "reflectance": colour}


def test_many_gradients_are_summed_in_memory() -> None:
    """More parameters than fit into registers need tables, which a frozen function has to make itself."""
    scene = djpt.load_dict(box(8, edit=many_walls))
    keys = [f"ball{k}.bsdf.reflectance.value" for k in range(20)]

    def gradients(step: Callable[..., Any], seed: int) -> np.ndarray:
        params = djpt.traverse(scene)
        for key in keys:
            params[key] = dr.detach(params[key])
            dr.enable_grad(params[key])
        params.update()
        step(scene, dr.zeros(TensorXf, (8, 8, 3)), UInt32(seed))
        return np.array([np.array(dr.grad(params[key])).ravel() for key in keys])

    frozen = dr.freeze(reverse)
    for seed in range(3):
        found, expected = gradients(frozen, seed), gradients(reverse, seed)
        assert np.abs(expected).max() > 0
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-7)


def test_parameters_of_meshes_survive_a_frozen_function() -> None:
    def looked_through(scene: djpt.Scene, seed: UInt32) -> TensorXf:
        djpt.traverse(scene)
        return image(scene, seed)

    scene, frozen = djpt.load_dict(box(8, edit=with_mesh)), dr.freeze(looked_through)
    for k in range(3):
        frozen(scene, UInt32(k))
    corners = np.array(djpt.traverse(scene)["tetrahedron.vertex_positions"])
    np.testing.assert_allclose(corners, np.array([-3, -3, 0, 3, -3, 0, 0, 3, 0, 0, 0, 4]) / 10, rtol=1e-6)


GARBAGE = """
import gc
import djpt
import drjit as dr, numpy as np
from tests.kit.renders import box

class Cycle:
    def __init__(self):
        self.itself, self.numbers = self, djpt.Float(np.zeros(64, np.float32))

@dr.freeze
def image(scene, spp):
    return djpt.render(scene, spp=spp)

scene = djpt.load_dict(box(4))
gc.set_threshold(100, 2, 2)
for spp in range(1, 5):
    for _ in range(200):
        Cycle()
    dr.eval(image(scene, spp))
print(gc.isenabled())
"""


def test_garbage_does_not_end_the_process_while_a_function_is_recorded() -> None:
    done = run_python("-c", GARBAGE)
    assert done.returncode == 0, done.stderr[-1500:]
    assert done.stdout.strip() == "True", "Python collects garbage again"


FIRST_USE = """
import djpt
import drjit as dr
mesh = djpt.Mesh("m", [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
try:
    dr.freeze(lambda shape, u: shape.sample_position(0, u))(mesh, dr.opaque(djpt.Point2f, 0.5, 2))
except RuntimeError as error:
    print(error)
print("ended")
"""


def test_functions_are_compiled_while_dr_jit_records() -> None:
    """The first use of a mesh in a process compiles functions in threads, which Dr.Jit doesn't answer then."""
    done = subprocess.run([sys.executable, "-c", FIRST_USE], capture_output=True, text=True, timeout=120)
    assert done.stdout.splitlines()[-1] == "ended"


def test_points_of_a_mesh_that_belongs_to_no_scene() -> None:
    mesh = djpt.Mesh("m", np.eye(3), [[0, 1, 2]])
    frozen = dr.freeze(lambda mesh, sample: mesh.sample_position(0, sample).p)
    sample = djpt.Point2f([0.1, 0.7], [0.2, 0.5])
    dr.make_opaque(sample)
    assert np.allclose(np.array(frozen(mesh, sample)), np.array(mesh.sample_position(0, sample).p))


def test_batches_of_sensors_stay_what_they_are() -> None:
    """A group of sensors looks up their values anew only if one has changed."""
    description = djpt.cornell_box()
    view = {**description["sensor"], "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}}
    other = {**view, "to_world": djpt.ScalarTransform4f().look_at([0.4, 0, 3.8], [0, 0, 0], [0, 1, 0])}
    film = {**view["film"], "width": 16}
    scene = djpt.load_dict({**description, "sensor": {"type": "batch", "film": film, "left": view, "right": other}})

    @dr.freeze
    def frozen(scene: djpt.Scene, paint: Any, seed: Any) -> Any:
        params = djpt.traverse(scene)
        params["white.reflectance.value"] = paint
        params.update()
        return djpt.render(scene, spp=2, seed=seed)

    for seed in range(5):
        paint = djpt.Color3f(0.1 * (1 + seed))
        dr.make_opaque(paint)
        found = frozen(scene, paint, dr.opaque(djpt.UInt32, seed)).numpy()
    assert frozen.n_recordings == 2
    assert np.array_equal(found, djpt.render(scene, spp=2, seed=4).numpy())

    def apart() -> float:
        image = djpt.render(scene, spp=256).numpy()
        return float(np.abs(image[:, 8:] - image[:, :8]).mean())

    before, params = apart(), djpt.traverse(scene)
    params["sensor.right.to_world"] = view["to_world"]
    params.update()
    assert apart() < 0.5 * before
