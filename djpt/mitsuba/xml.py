"""Scene files as dicts, and back: what `djpt.load_file` and `djpt.write_dict` are made of.

    description = djpt.xml.read_file("scene.xml", spp=64)
    description["sensor"]["film"]["width"] = 1920
    scene = djpt.load_dict(description)

Errors of the loader then still name the file and the line.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from djpt.description.files import Document
from djpt.description.xml.reading import read_file, read_string
from djpt.description.xml.writer import to_xml, write_dict

__all__ = ["Document", "dict_to_xml", "read_file", "read_string", "to_xml", "write_dict"]


def dict_to_xml(scene_dict: Mapping[str, Any], filename: str | os.PathLike[str], split_files: bool = False) -> None:
    """`djpt.write_dict` under the name and with the arguments of Mitsuba.

    Args:
        scene_dict: the description.
        filename: the file to write.
        split_files: accepted for Mitsuba's signature, no effect: there is one file.
    """
    write_dict(filename, scene_dict)
