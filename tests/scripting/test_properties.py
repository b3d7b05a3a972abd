"""`Properties` as scripts make and read them, and the objects made from them."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest

import djpt
from djpt.errors import SceneError

Type = djpt.Properties.Type

KNOWN = "diffuse path area perspective independent sphere bitmap hdrfilm box scene"
LACKING = "hg constvolume homogeneous nothing"


def filled() -> djpt.Properties:
    props = djpt.Properties("plastic")
    for key, value in {"count": 2, "name": "a", "on": True, "size": 1.5, "up": [0, 1, 0], "at": np.float32(2)}.items():
        props[key] = value
    return props


def test_entries_keep_their_type_and_order() -> None:
    props = filled()
    assert props.keys() == list(props) == ["count", "name", "on", "size", "up", "at"]
    kinds = [Type.Integer, Type.String, Type.Bool, Type.Float, Type.Vector, Type.Float]
    assert [props.type(key) for key in props] == kinds
    props["tint"] = djpt.Color3f(1)
    props["T"] = djpt.ScalarTransform4f()
    props["child"] = djpt.load_dict({"type": "diffuse"})
    assert [props.type(key) for key in ("tint", "T", "child")] == [Type.Color, Type.Transform, Type.Object]
    assert [props.as_string(key) for key in ("count", "name", "on")] == ["2", "a", "true"]
    assert dict(props.items())["at"] == 2.0 and len(props) == 9


def test_a_new_value_comes_last_and_a_deleted_one_is_gone() -> None:
    props = filled()
    del props["name"]
    props["name"] = "b"
    assert props.keys()[-1] == "name" and "none" not in props
    with pytest.raises(KeyError, match="did you mean 'count'"):
        del props["cuont"]


def test_what_was_asked_for() -> None:
    props = filled()
    assert props["count"] == 2 and props.get("name") == "a" and props.get("absent", 3) == 3
    assert props.was_queried("count") and not props.was_queried("on")
    assert props.unqueried() == ["on", "size", "up", "at"]
    assert props.mark_queried("on") and not props.mark_queried("absent")
    assert props.unqueried() == ["size", "up", "at"]
    with pytest.raises(SceneError, match="there is no entry 'absent'"):
        props.was_queried("absent")


def test_copies_and_merges() -> None:
    props, other = filled(), djpt.Properties()
    other["name"] = 4
    copied = djpt.Properties(props)
    assert copied == props and copied.plugin_name() == "plastic"
    copied.merge(other)
    assert copied["name"] == 4 and props["name"] == "a" and copied != props
    props.set_id("x")
    assert djpt.Properties(props).id() == "x"
    assert repr(other) == 'Properties[\n  plugin_name = "",\n  id = "",\n  elements = {\n    "name" -> 4\n  }\n]\n'


@pytest.mark.parametrize("value", [None, {"type": "diffuse"}, np.complex64(1)])
def test_values_that_cant_be_stored(value: Any) -> None:
    with pytest.raises(SceneError, match="'key' can't hold"):
        djpt.Properties()["key"] = value


@pytest.mark.parametrize("call", ["has_property('name')", "property_names()", "remove_property('name')"])
def test_deprecated_forms(call: str) -> None:
    with pytest.warns(DeprecationWarning, match=r"is deprecated: use"):
        assert eval(f"props.{call}", {"props": filled()})


def test_a_plugin_from_properties() -> None:
    manager = djpt.PluginManager.instance()
    props = djpt.Properties("path")
    props["max_depth"] = 4
    props.set_id("mine")
    made = manager.create_object(props)
    assert made.max_depth == 4 and made.id() == "mine" and isinstance(made, djpt.Object)
    assert made.variant_name() == djpt.variant() and made.class_name() == "PathIntegrator"
    assert str(made) == "PathIntegrator[\n  max_depth = 4,\n  rr_depth = 5\n]"
    props["max_dept"] = 4
    with pytest.raises(SceneError, match="unknown key 'max_dept'"):
        manager.create_object(props)


@pytest.mark.parametrize("name", [*KNOWN.split(), *LACKING.split()])
def test_kinds_are_mitsubas(name: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    theirs = mi.PluginManager.instance().plugin_type(name)
    mine = djpt.PluginManager.instance().plugin_type(name)
    assert (mine.name, mine.value) == (theirs.name, theirs.value)


def test_names_of_objects() -> None:
    thing = djpt.Object()
    thing.set_id("thing")
    assert thing.id() == djpt.Object(thing).id() == "thing"


def test_a_script_registers_a_material() -> None:
    class Tinted(djpt.BSDF):
        def __init__(self, props: djpt.Properties) -> None:
            djpt.BSDF.__init__(self, props)
            self.tint = props.get("tint", 0.5)
            self.named = props.id()

    djpt.register_bsdf("tinted_by_script", lambda props: Tinted(props))
    made = djpt.load_dict({"type": "tinted_by_script", "tint": 0.25, "id": "name"})
    assert made.tint == 0.25 and made.named == made.id() == "name"


def test_flags_of_parameters_are_mitsubas() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    assert {f.name: f.value for f in djpt.ParamFlags} | {"Differentiable": 0} == {
        name: f.value for name, f in mi.ParamFlags.__members__.items()
    }


def test_callbacks_of_scripts() -> None:
    """A script may visit plugins itself, and its plugins may report by the former names."""

    class Names(djpt.TraversalCallback):
        def __init__(self) -> None:
            self.found: list[str] = []

        def put(self, name: str, value: Any, flags: Any = 1, attribute: str | None = None) -> None:
            self.found.append(name)
            if isinstance(value, djpt.Object):
                value.traverse(self)

    class Old(djpt.BSDF):
        def __init__(self, props: djpt.Properties) -> None:
            super().__init__(props)
            self.gain, self.fixed = djpt.Float(2), djpt.Float(1)
            self.inner = djpt.load_dict({"type": "diffuse"})

        def traverse(self, callback: Any) -> None:
            callback.put_value("gain", self.gain, djpt.ParamFlags.Differentiable)
            callback.put_parameter("fixed", self.fixed, djpt.ParamFlags.ReadOnly)
            callback.put_object("inner", self.inner, djpt.ParamFlags.Differentiable)

    names, plugin = Names(), Old(djpt.Properties("old"))
    plugin.traverse(names)
    assert names.found == ["gain", "fixed", "inner", "reflectance", "value"]
    params = djpt.traverse(plugin)
    assert list(params) == ["gain", "fixed", "inner.reflectance.value"]
    params["gain"] = 3
    with pytest.raises(djpt.ParameterError, match="fixed: can't be assigned"):
        params["fixed"] = 2
    with pytest.raises(NotImplementedError):
        djpt.TraversalCallback().put("name", 1)


def test_flags_of_nested_plugins_are_added_to_their_parameters() -> None:
    class Inner(djpt.Texture):
        def traverse(self, callback: Any) -> None:
            callback.put("smooth", 0.1, djpt.ParamFlags.Differentiable)
            callback.put("edge", 0.1, djpt.ParamFlags.Differentiable | djpt.ParamFlags.Discontinuous)

    class Outer(djpt.BSDF):
        def __init__(self, props: djpt.Properties) -> None:
            super().__init__(props)
            self.children_by_name = {name: Inner(djpt.Properties("inner")) for name in FLAGS}

        def traverse(self, callback: Any) -> None:
            for name, child in self.children_by_name.items():
                callback.put(name, child, FLAGS[name]) if FLAGS[name] is not None else callback.put(name, child)

    kinds = djpt.ParamFlags
    FLAGS = {
        "plain": None,
        "as_said": kinds.Differentiable,
        "fixed": kinds.NonDifferentiable,
        "cut": kinds.Discontinuous,
    }
    params = djpt.traverse(Outer(djpt.Properties("outer")))
    assert {key: params.flags(key) for key in params} == {
        "plain.smooth": kinds.Differentiable,
        "plain.edge": kinds.Discontinuous,
        "as_said.smooth": kinds.Differentiable,
        "as_said.edge": kinds.Discontinuous,
        "fixed.smooth": kinds.NonDifferentiable,
        "fixed.edge": kinds.NonDifferentiable,
        "cut.smooth": kinds.Discontinuous,
        "cut.edge": kinds.Discontinuous,
    }


def test_a_plugin_may_report_a_value_that_no_attribute_holds():
    class Passing(djpt.BSDF):
        changed: ClassVar[list[str]] = []

        def traverse(self, callback):
            callback.put("passing", 0.25, djpt.ParamFlags.Differentiable)
            callback.put("fixed", 2.0, djpt.ParamFlags.NonDifferentiable)

        def parameters_changed(self, keys):
            self.changed.extend(keys)

    djpt.register_bsdf("passing_test", Passing)
    bsdf = djpt.load_dict({"type": "passing_test"})
    params = djpt.traverse(bsdf)
    assert params["passing"][0] == 0.25 and params["fixed"] == 2.0
    assert params.flags("passing") == djpt.ParamFlags.Differentiable
    params["fixed"] = 2.0
    params.update()
    assert Passing.changed == []
    params["passing"] = 0.5
    params.update()
    assert Passing.changed == ["passing"] and bsdf.passing[0] == 0.5
    assert djpt.traverse(bsdf)["passing"][0] == 0.5


def test_class_names_are_those_of_mitsuba(mi: Any) -> None:
    """Of a plugin of each kind, alone and in a scene."""

    def names(m: Any) -> list[str]:
        scene = m.load_dict(m.cornell_box())
        sensor = scene.sensors()[0]
        parts = [scene, scene.integrator(), sensor, sensor.film(), sensor.sampler(), sensor.film().rfilter()]
        parts += [*scene.emitters(), scene.shapes()[-1].bsdf()]
        alone = ["moment", "volpath", "ptracer", "hg", "envmap", "roughconductor", "checkerboard", "homogeneous"]
        alone += ["sphere", "rectangle"]
        nested = {"moment": {"i": {"type": "path"}}, "envmap": {"bitmap": m.Bitmap(np.ones((4, 4, 3), np.float32))}}
        parts += [m.load_dict({"type": name, **nested.get(name, {})}) for name in alone]
        if m is djpt:
            assert all(str(part).startswith(f"{part.class_name()}[") for part in parts[1:])
        return [part.class_name() for part in parts]

    assert names(djpt) == names(mi)


def test_a_class_of_a_script_has_its_own_name() -> None:
    class Chalk(djpt.BSDF):
        pass

    djpt.register_bsdf("chalk_of_this_test", Chalk)
    assert djpt.load_dict({"type": "chalk_of_this_test"}).class_name() == "Chalk"
