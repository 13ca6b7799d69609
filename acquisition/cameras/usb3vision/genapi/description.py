"""Parses the XML of a camera's description into plain values."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from typing import Final

from processing.errors import DeviceError

# elements that only contain nodes
_CONTAINERS: Final = {"Group", "RegisterDescription"}


@dataclass(frozen=True, slots=True)
class Property:
    """One element inside a node: its tag, text, attributes and child elements."""

    tag: str
    text: str
    attributes: dict[str, str]
    children: tuple["Property", ...] = ()


@dataclass(frozen=True, slots=True)
class NodeDescription:
    """One node of the description; `kind` is its tag."""

    kind: str
    name: str
    properties: tuple[Property, ...]

    def all(self, tag: str) -> tuple[Property, ...]:
        """All properties with this tag, in order."""
        return tuple(item for item in self.properties if item.tag == tag)

    def text(self, tag: str) -> str | None:
        """Text of the first property with this tag."""
        for item in self.properties:
            if item.tag == tag:
                return item.text
        return None


def parse_description(xml: str, name: str) -> dict[str, NodeDescription]:
    """All nodes by their names; each field of a StructReg becomes a MaskedIntReg.

    Raises
    ------
    DeviceError
        The text is not XML, or not the description of a camera.
    """
    # the text is already decoded: the parser would fail on a declaration of another encoding
    body = re.sub(r"^\s*<\?xml[^>]*\?>", "", xml, count=1)
    try:
        root = ElementTree.fromstring(body)
    except (ElementTree.ParseError, ValueError) as damage:
        raise DeviceError(f"{name}: the camera's description is malformed XML: {damage}") from damage
    if _local(root.tag) != "RegisterDescription":
        raise DeviceError(
            f"{name}: the camera's description is a {_local(root.tag)!r}, not a RegisterDescription"
        )
    nodes: dict[str, NodeDescription] = {}
    try:
        _collect(root, nodes)
    except RecursionError:
        raise DeviceError(f"{name}: the camera's description is nested too deeply to be one") from None
    if not nodes:
        raise DeviceError(f"{name}: the camera's description has no features")
    return nodes


def _local(tag: str) -> str:
    return tag.rpartition("}")[2]


def _collect(element: ElementTree.Element, nodes: dict[str, NodeDescription]) -> None:
    pending = [element]
    while pending:
        parent = pending.pop()
        for child in parent:
            if not isinstance(child.tag, str):
                continue  # a comment
            kind, name = _local(child.tag), child.get("Name", "")
            if kind in _CONTAINERS:
                pending.append(child)
            elif kind == "StructReg":
                for field in _fields(child):
                    nodes[field.name] = field
            elif name:
                nodes[name] = NodeDescription(kind, name, tuple(_property(item) for item in _elements(child)))


def _elements(element: ElementTree.Element) -> list[ElementTree.Element]:
    return [item for item in element if isinstance(item.tag, str)]


def _property(element: ElementTree.Element) -> Property:
    children = tuple(_property(child) for child in _elements(element))
    return Property(_local(element.tag), (element.text or "").strip(), dict(element.attrib), children)


def _fields(struct: ElementTree.Element) -> list[NodeDescription]:
    """Fields of a StructReg; each has the properties of the StructReg, unless it states its own."""
    items = [_property(item) for item in _elements(struct)]
    common = [item for item in items if item.tag != "StructEntry"]
    fields = []
    for entry in items:
        if entry.tag == "StructEntry" and "Name" in entry.attributes:
            own = {child.tag for child in entry.children}
            inherited = tuple(item for item in common if item.tag not in own)
            fields.append(
                NodeDescription("MaskedIntReg", entry.attributes["Name"], (*entry.children, *inherited))
            )
    return fields
