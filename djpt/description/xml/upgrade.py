"""The upgrade of names of Mitsuba 0.x, for files whose version is below 2.0.0.

The changes are Mitsuba 3's own: camelCase became snake_case, and a few parameters were renamed or merged.
"""

from __future__ import annotations

import re

from djpt.description.xml.nodes import Entry, Node

__all__ = ["Version", "is_old", "parse_version", "upgrade_name", "upgrade_node", "upgrade_tag"]

Version = tuple[int, int, int]

_UV = ("uoffset", "voffset", "uscale", "vscale")


def parse_version(text: str) -> Version | None:
    """Parse a version such as ``3.0.0``; None if it isn't one. Missing parts are 0."""
    if not re.fullmatch(r"\d{1,6}(\.\d{1,6}){0,2}", text.strip(), re.ASCII):
        return None
    parts = [int(part) for part in text.split(".")]
    major, minor, patch = [*parts, 0, 0][:3]
    return major, minor, patch


def is_old(version: Version) -> bool:
    """True if files of this version use the old names."""
    return version < (2, 0, 0)


def upgrade_tag(tag: str) -> str:
    """The current name of a tag."""
    return "lookat" if tag == "lookAt" else tag


def upgrade_name(name: str) -> str:
    """The current form of a name: ``toWorld`` -> ``to_world``, ``intIOR`` -> ``int_ior``."""
    return re.sub(r"(?<=[a-z])([A-Z]+)", lambda found: "_" + found[1].lower(), name)


def upgrade_node(node: Node) -> None:
    """Rename and merge parameters, after `upgrade_name`."""
    reflectance = node.find("diffuse_reflectance")
    if node.type == "diffuse" and reflectance is not None and node.find("reflectance") is None:
        reflectance.name = "reflectance"
    found = {entry.name: entry for entry in node.entries if entry.name in _UV}
    if not found or not all(isinstance(entry.value, (int, float)) for entry in found.values()):
        return  # the loader reports what is wrong with other values
    from djpt.core.transforms import ScalarTransform4f  # here: NumPy takes long to import

    offset = [found[name].value if name in found else 0.0 for name in ("uoffset", "voffset")]
    scale = [found[name].value if name in found else 1.0 for name in ("uscale", "vscale")]
    to_uv = ScalarTransform4f.scale([*scale, 1.0]).translate([*offset, 0.0])
    place = next(iter(found.values())).place
    node.entries = [entry for entry in node.entries if entry.name not in _UV]
    node.append(Entry("to_uv", to_uv, place))
