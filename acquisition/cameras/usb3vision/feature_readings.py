"""All features of a camera with value, limits and choices, for display and for the record."""

from collections.abc import Iterator
from dataclasses import dataclass

from acquisition.camera import CameraLost
from acquisition.cameras.usb3vision.genapi.choice_nodes import Enumeration
from acquisition.cameras.usb3vision.genapi.node import Access
from acquisition.cameras.usb3vision.genapi.node_map import NodeMap
from processing.errors import DeviceError


@dataclass(frozen=True, slots=True)
class FeatureReading:
    """One feature for display. `value` is None if it cannot be read; `problem` is then the reason."""

    name: str
    kind: str
    value: int | float | bool | str | bytes | None
    access: str
    minimum: float | None
    maximum: float | None
    unit: str
    choices: tuple[str, ...]
    problem: str


def read_all(nodes: NodeMap) -> Iterator[FeatureReading]:
    """All implemented features of the camera and their present values; faulty ones have a `problem`."""
    nodes.forget()
    for name in nodes.features():
        node = nodes.node(name)
        access, value, low, high, problem = "", None, None, None, ""
        choices: tuple[str, ...] = ()
        try:
            mode = node.access()
            access = mode.value
            if mode is Access.NOT_IMPLEMENTED:
                continue
            if mode.readable and hasattr(node, "get"):
                value = nodes.get(name)
                low, high = node.minimum(), node.maximum()
            choices = node.choices() if isinstance(node, Enumeration) else ()
        except CameraLost:
            raise
        except DeviceError as error:
            problem = str(error)
        unit = node.description.text("Unit") or ""
        kind = node.description.kind
        yield FeatureReading(name, kind, value, access, low, high, unit, choices, problem)
