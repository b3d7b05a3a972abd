"""Descriptions as XML, valid or not."""

from __future__ import annotations

from typing import Any
from xml.sax.saxutils import quoteattr

from djpt.description.registry import kind_of
from tests.fuzz.values import Code

__all__ = ["xml_text"]


def xml_text(node: Any) -> str:
    """A scene file of a description, whose values may be anything."""
    return element(node, "scene", version=' version="3.0.0"')


def element(node: Any, key: str, indent: str = "", version: str = "") -> str:
    """The element of an entry called `key`. Objects in the scene itself have ids."""
    name = f" name={quoteattr(key)}"
    if isinstance(node, dict):
        kind = node.get("type")
        if kind == "ref":
            return f"{indent}<ref{name} id={quoteattr(str(node.get('id')))}/>"
        tag = "scene" if kind == "scene" else kind_of(str(kind)) or "bsdf"
        inner = [element(v, str(k), indent + "  ") for k, v in node.items() if k != "type"]
        attributes = "" if kind == "scene" else f" type={quoteattr(str(kind))}"
        identity = f" id={quoteattr(key)}" if indent == "  " else ""
        label = "" if version else name
        return "\n".join([f"{indent}<{tag}{attributes}{version}{identity}{label}>", *inner, f"{indent}</{tag}>"])
    if isinstance(node, Code) and node.startswith("T()"):
        operations = '<translate x="1"/><rotate y="1" angle="30"/>' + ('<scale value="0"/>' if "0)" in node else "")
        return f"{indent}<transform{name}>{operations}</transform>"
    if isinstance(node, bool):
        tag, text = "boolean", str(node).lower()
    elif isinstance(node, int):
        tag, text = "integer", str(node)
    elif isinstance(node, float):
        tag, text = "float", repr(node)
    elif isinstance(node, list):
        tag, text = "vector", ", ".join(map(str, node))
    else:
        tag, text = "string", str(node)
    return f"{indent}<{tag}{name} value={quoteattr(text.strip(chr(39)))}/>"
