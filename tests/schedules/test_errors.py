"""What can't be rendered is refused in one readable sentence, never by an abort."""

from __future__ import annotations

import warnings
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import DjptError, ParameterError, RenderError, SceneError
from tests.kit.renders import box

PATH = {"type": "path", "max_depth": 3}


@pytest.fixture(scope="module")
def scene() -> Any:
    return djpt.load_dict(box(8, "box", PATH))


def without(*names: str) -> Any:
    description = box(8, "box", PATH)
    for name in names:
        del description[name]
    return djpt.load_dict(description)


# ---------------------------------------------------------------- arguments


@pytest.mark.parametrize("name", ["spp", "spp_grad", "pass_spp"])
@pytest.mark.parametrize("value", [2**32, 2**64, 10**30])
def test_counts_fit_into_32_bits(scene: djpt.Scene, name: str, value: int) -> None:
    with pytest.raises(djpt.RenderError, match=f"'{name}' must be below 2\\^32, found {value}"):
        djpt.render(scene, **{"spp": 1, name: value})


@pytest.mark.parametrize("progress", [5, "bar"])
def test_progress_is_a_function(scene: djpt.Scene, progress: object) -> None:
    with pytest.raises(djpt.RenderError, match="'progress' must be a function"):
        djpt.render(scene, spp=1, progress=progress)  # type: ignore[arg-type]


@pytest.mark.parametrize("integrator", ["path", "path_naive"])
def test_paths_end_where_nothing_is_absorbed(integrator: str) -> None:
    """A white furnace without roulette: paths have 2^16 edges, and a warning says so."""
    with pytest.warns(UserWarning, match="paths may have 65536 edges where little is absorbed"):
        furnace = djpt.load_dict(
            {
                "type": "scene",
                "integrator": {"type": integrator, "rr_depth": 10**6},
                "room": {"type": "sphere", "flip_normals": True, "bsdf": {"type": "diffuse", "reflectance": 1.0}},
                "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 2, "height": 2}},
                "light": {"type": "point", "intensity": 0.0},
            }
        )
    assert (djpt.render(furnace, spp=1).numpy() == 0).all()


@pytest.mark.parametrize("name", ["spp", "spp_grad", "pass_spp"])
@pytest.mark.parametrize("value", [-1, 1.5, True, "4", None, float("nan")], ids=repr)
def test_counts(scene: Any, name: str, value: Any) -> None:
    with pytest.raises(RenderError, match=f"'{name}' must be a whole number"):
        djpt.render(scene, **{"spp": 1, name: value})


@pytest.mark.parametrize("value", [-1, 2**32, 1.0, False, "0", None], ids=repr)
def test_seeds(scene: Any, value: Any) -> None:
    with pytest.raises(RenderError, match="'seed' must be a whole number"):
        djpt.render(scene, spp=1, seed=value)


@pytest.mark.parametrize("value", [-1, 2**32, 1.5, "0"], ids=repr)
def test_seeds_of_gradients(scene: Any, value: Any) -> None:
    with pytest.raises(RenderError, match="seed_grad"):
        djpt.render(scene, spp=1, seed_grad=value)


def test_default_counts(scene: Any) -> None:
    """0 takes the sampler's `sample_count`, in the dict or 4."""
    description = box(8, "box", PATH)
    description["sensor"]["sampler"]["sample_count"] = 3
    few = djpt.load_dict(description)
    np.testing.assert_array_equal(np.array(djpt.render(few)), np.array(djpt.render(few, spp=3)))
    del description["sensor"]["sampler"]
    four = djpt.load_dict(description)
    np.testing.assert_array_equal(np.array(djpt.render(four)), np.array(djpt.render(four, spp=4)))


def test_integers_of_other_libraries(scene: Any) -> None:
    """NumPy's integers count as whole numbers."""
    image = djpt.render(scene, spp=np.int64(2), seed=np.uint32(1))
    np.testing.assert_array_equal(np.array(image), np.array(djpt.render(scene, spp=2, seed=1)))


@pytest.mark.parametrize("sensor", [1, -2, 7])
def test_sensor_out_of_range(scene: Any, sensor: int) -> None:
    with pytest.raises(RenderError, match=f"there is no sensor {sensor}: the scene has 1, "):
        djpt.render(scene, sensor=sensor, spp=1)


@pytest.mark.parametrize("sensor", ["sensor", None, 0.0, True])
def test_not_a_sensor(scene: Any, sensor: Any) -> None:
    with pytest.raises(RenderError, match="'sensor' must be an index or a sensor"):
        djpt.render(scene, sensor=sensor, spp=1)


@pytest.mark.parametrize("integrator", ["path", 3, {"type": "path"}], ids=str)
def test_not_an_integrator(scene: Any, integrator: Any) -> None:
    with pytest.raises(RenderError, match="'integrator' must be an integrator"):
        djpt.render(scene, integrator=integrator, spp=1)


def test_a_bsdf_is_no_integrator(scene: Any) -> None:
    with pytest.raises(RenderError, match="'integrator' must be an integrator"):
        djpt.render(scene, integrator=djpt.load_dict({"type": "diffuse"}), spp=1)


@pytest.mark.parametrize("schedule", ["flatt", "", "machines", 3, None, djpt.Float(1), np.array(["flat"] * 2)], ids=str)
def test_unknown_schedule(scene: Any, schedule: Any) -> None:
    with pytest.raises(RenderError, match="unknown schedule"):
        djpt.render(scene, spp=1, schedule=schedule)


def test_near_miss_of_a_schedule(scene: Any) -> None:
    with pytest.raises(RenderError, match="did you mean 'flat'"):
        djpt.render(scene, spp=1, schedule="flatt")


def test_schedule_that_the_integrator_lacks(scene: Any) -> None:
    with pytest.raises(RenderError, match="use schedule='wave'"):
        djpt.render(scene, integrator=djpt.load_dict({"type": "depth"}), spp=1, schedule="flat")


@pytest.mark.parametrize("thing", [None, {"type": "scene"}, "cornell_box", 3], ids=str)
def test_not_a_scene(thing: Any) -> None:
    with pytest.raises(RenderError, match="expects a scene from load_dict"):
        djpt.render(thing)


def test_more_samples_than_numbers() -> None:
    description = box((4096, 4096), "box", PATH)
    with pytest.raises(RenderError, match=r"more than 2\^32 samples"):
        djpt.render(djpt.load_dict(description), spp=257)


# ---------------------------------------------------------------- scenes


def test_no_sensor() -> None:
    with pytest.raises(RenderError, match="no sensor"):
        djpt.render(without("sensor"), spp=1)


@pytest.mark.parametrize("integrator", ["path", "prb", "direct"])
def test_no_emitter(integrator: str) -> None:
    with pytest.raises(RenderError, match="no emitter"):
        djpt.render(without("light"), integrator=djpt.load_dict({"type": integrator}), spp=1)


@pytest.mark.parametrize("integrator", [{"type": "depth"}, {"type": "aov", "aovs": "n:sh_normal"}], ids=str)
def test_no_emitter_is_needed(integrator: dict[str, Any]) -> None:
    image = np.array(djpt.render(without("light"), integrator=djpt.load_dict(integrator), spp=1))
    assert np.abs(image).max() > 0.5


def test_default_integrator() -> None:
    """A scene without an integrator is path traced."""
    image = np.array(djpt.render(without("integrator"), spp=1))
    with_path = np.array(djpt.render(without("integrator"), integrator=djpt.load_dict({"type": "path"}), spp=1))
    np.testing.assert_array_equal(image, with_path)


@pytest.mark.parametrize("integrator", ["path", "direct", "depth"])
@pytest.mark.parametrize("light", ["point", "constant"])
def test_nothing_but_light(light: str, integrator: str) -> None:
    description = {"type": "scene", "sensor": box(8)["sensor"], "light": {"type": light}}
    image = np.array(djpt.render(djpt.load_dict(description), integrator=djpt.load_dict({"type": integrator}), spp=1))
    np.testing.assert_allclose(image, float(light == "constant" and integrator != "depth"), rtol=1e-6)


@pytest.mark.parametrize("film", [{"width": 0}, {"height": 0}, {"width": -3}, {"width": 2.5}, {"width": "8"}], ids=str)
def test_films_without_pixels(film: dict[str, Any]) -> None:
    description = box(8, "box", PATH)
    description["sensor"]["film"].update(film)
    with pytest.raises(SceneError, match=r"sensor\.film"):
        djpt.load_dict(description)


@pytest.mark.parametrize(
    "film",
    [
        {"crop_width": 9},
        {"crop_offset_x": 8},
        {"crop_offset_x": 1},
        {"crop_width": 0},
        {"crop_offset_x": -1},
        {"crop_height": -2},
    ],
    ids=str,
)
def test_crops_that_do_not_fit(film: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match=r"sensor\.film"):
        djpt.load_dict(box(8, "box", PATH, **film))


@pytest.mark.parametrize("size", [[0, 4], [4], [-1, 3], "big", None, [2.5, 3]], ids=str)
def test_film_sizes_by_parameter(size: Any) -> None:
    params = djpt.traverse(without())
    with pytest.raises(ParameterError, match="size"):
        params["sensor.film.size"] = size
        params.update()


NAN = np.eye(4)
NAN[0, 3] = np.nan
SINGULAR = np.diag([1.0, 0.0, 1.0, 1.0])


@pytest.mark.parametrize(
    "matrix", [NAN, SINGULAR, np.full((4, 4), np.inf), np.eye(3)], ids=["nan", "flat", "inf", "3x3"]
)
@pytest.mark.parametrize("node", ["floor", "large-box", "sensor"])
def test_bad_transforms(node: str, matrix: Any) -> None:
    description = box(8, "box", PATH)
    description[node]["to_world"] = matrix
    with pytest.raises(SceneError, match=f"{node}.*to_world"):
        djpt.load_dict(description)


@pytest.mark.parametrize("matrix", [NAN, SINGULAR], ids=["nan", "flat"])
def test_bad_transforms_by_parameter(matrix: Any) -> None:
    params = djpt.traverse(without())
    before = np.array(params["floor.to_world"].matrix)
    with pytest.raises(DjptError):
        params["floor.to_world"] = matrix
        params.update()
    np.testing.assert_array_equal(np.array(djpt.traverse(without())["floor.to_world"].matrix), before)


@pytest.mark.parametrize("value", [1.2, -0.1, float("nan"), [0.1, 0.2, 2.0]], ids=str)
def test_reflectances_out_of_range(value: Any) -> None:
    description = box(8, "box", PATH)
    description["red"]["reflectance"]["value"] = value
    with pytest.raises(SceneError, match=r"red.*reflectance"):
        djpt.load_dict(description)
    params = djpt.traverse(without())
    with pytest.raises(ParameterError, match="reflectance"):
        params["red.reflectance.value"] = value
        params.update()


@pytest.mark.parametrize("value", [-1.0, float("inf"), float("nan")], ids=str)
@pytest.mark.parametrize("emitter", [{"type": "point"}, {"type": "constant"}], ids=str)
def test_lights_out_of_range(emitter: dict[str, Any], value: float) -> None:
    key = "intensity" if emitter["type"] == "point" else "radiance"
    with pytest.raises(SceneError, match=key):
        djpt.load_dict({"type": "scene", "lamp": {**emitter, key: value}})


@pytest.mark.parametrize(
    ("integrator", "problem"),
    [
        ({"type": "path", "max_depth": -2}, "max_depth"),
        ({"type": "path", "rr_depth": 0}, "rr_depth"),
        ({"type": "direct", "shading_samples": 0}, "shading_samples"),
        ({"type": "direct", "emitter_samples": 0, "bsdf_samples": 0}, "can't both be 0"),
        ({"type": "direct", "shading_samples": 2, "bsdf_samples": 1}, "shading_samples"),
        ({"type": "aov"}, "aovs"),
        ({"type": "aov", "aovs": "depth"}, "name:variable"),
        ({"type": "aov", "aovs": "d:dept"}, "did you mean 'depth'"),
        ({"type": "aov", "aovs": "d:depth,d:uv"}, "twice"),
        ({"type": "path", "maxdepth": 3}, "did you mean 'max_depth'"),
    ],
    ids=str,
)
def test_integrator_parameters(integrator: dict[str, Any], problem: str) -> None:
    with pytest.raises(SceneError, match=problem):
        djpt.load_dict(integrator)


def test_structure_of_a_scene() -> None:
    sensor = box(8)["sensor"]
    two_skies = {"type": "scene", "sensor": sensor, "a": {"type": "constant"}, "b": {"type": "constant"}}
    with pytest.raises(SceneError, match="one environment"):
        djpt.load_dict(two_skies)
    with pytest.raises(SceneError, match="integrator"):
        djpt.load_dict({"type": "scene", "a": {"type": "path"}, "b": {"type": "direct"}})
    with pytest.warns(UserWarning, match="no shape refers"):
        djpt.load_dict({"type": "scene", "a": {"type": "area"}})
    with pytest.raises(SceneError, match="area"):
        djpt.load_dict({"type": "scene", "a": {"type": "rectangle", "emitter": {"type": "point"}}})


# ---------------------------------------------------------------- gradients


def test_gradient_of_a_position_is_refused() -> None:
    description = box(8, "box", PATH)
    description["lamp"] = {"type": "point", "position": [0, 0, 0.5]}
    loaded = djpt.load_dict(description)
    params = djpt.traverse(loaded)
    dr.enable_grad(params["lamp.position"])
    params.set_dirty("lamp.position")
    params.update()
    with pytest.raises(DjptError, match=r"'lamp' moves .* follows no silhouettes"):
        djpt.render(loaded, params, spp=1)


def test_gradient_of_a_camera_is_refused() -> None:
    loaded = without()
    params = djpt.traverse(loaded)
    with pytest.raises(DjptError, match="gradient"):
        params["sensor.x_fov"] = attached(params["sensor.x_fov"])
        params.update()
        djpt.render(loaded, params, spp=1)


def test_gradient_of_vertices_is_refused() -> None:
    loaded = without()
    params = djpt.traverse(loaded)
    with pytest.raises(DjptError, match="gradient"):
        params["large-box.vertex_positions"] = attached(params["large-box.vertex_positions"])
        params.update()
        djpt.render(loaded, params, spp=1)


def attached(value: Any) -> Any:
    copy = djpt.Float(value)
    dr.enable_grad(copy)
    return copy


def test_plain_differentiation_of_too_much() -> None:
    loaded = djpt.load_dict(box((1024, 1024), "box", {"type": "direct"}))
    params = djpt.traverse(loaded)
    dr.enable_grad(params["red.reflectance.value"])
    params.update()
    with pytest.raises(RenderError, match="spp_grad"):
        djpt.render(loaded, params, spp=1, spp_grad=64)


def test_after_an_error_all_goes_on(scene: Any) -> None:
    before = np.array(djpt.render(scene, spp=2))
    for bad in ({"spp": -1}, {"seed": -1}, {"schedule": "x"}, {"sensor": 5}):
        with pytest.raises(RenderError):
            djpt.render(scene, **bad)
    np.testing.assert_array_equal(np.array(djpt.render(scene, spp=2)), before)


def test_an_error_inside_an_integrator_is_the_users(scene: Any) -> None:
    """What a user's own code raises comes through, and the next image is whole."""

    class Broken(djpt.integrators.Integrator):
        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            raise ZeroDivisionError("mine")

    before = np.array(djpt.render(scene, spp=2))
    djpt.register_integrator("broken_for_tests", Broken)
    with pytest.raises(ZeroDivisionError, match="mine"):
        djpt.render(scene, integrator=djpt.load_dict({"type": "broken_for_tests"}), spp=1)
    np.testing.assert_array_equal(np.array(djpt.render(scene, spp=2)), before)


def test_transforms_of_a_sensor_may_not_scale() -> None:
    description = box(8, "box", PATH)
    description["sensor"]["to_world"] = T().scale(2.0)
    with pytest.raises(SceneError, match=r"sensor.*to_world"):
        djpt.load_dict(description)


@pytest.mark.parametrize("bsdf", ["conductor", "dielectric", "null"])
def test_materials_that_light_sampling_alone_cannot_show(bsdf: str) -> None:
    """One warning that names them; none where the integrator samples BSDFs, or where they aren't."""
    lights_only = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    shiny = box(8, "box", lights_only)
    shiny["small-box"]["bsdf"] = {"type": bsdf, "id": "shiny"}
    with pytest.warns(UserWarning, match="shiny") as caught:
        djpt.render(djpt.load_dict(shiny), spp=1)
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        djpt.render(djpt.load_dict({**shiny, "integrator": {"type": "direct"}}), spp=1)
        djpt.render(djpt.load_dict(box(8, "box", lights_only)), spp=1)
