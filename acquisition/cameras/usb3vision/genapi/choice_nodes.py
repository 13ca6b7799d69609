"""Nodes that are switches, enumerations or commands."""

from typing import Any

from acquisition.cameras.usb3vision.genapi.description import NodeDescription
from acquisition.cameras.usb3vision.genapi.node import Access, Node, Nodes, parse_number
from acquisition.cameras.usb3vision.genapi.operators import Number, truncated
from acquisition.cameras.usb3vision.genapi.value_nodes import Valued
from processing.errors import DeviceError


class Boolean(Valued):
    """A switch."""

    def _on_off(self) -> tuple[int, int]:
        on, off = self.description.text("OnValue"), self.description.text("OffValue")
        return int(parse_number(on or "1")), int(parse_number(off or "0"))

    def own_number(self) -> Number:
        text = self.description.text("Value")
        if self.name not in self.nodes.own_values and text in ("true", "false"):
            return self._on_off()[text == "false"]
        return super().own_number()

    def get(self) -> bool:
        """True if it is on."""
        return self.number() != 0

    def number(self) -> Number:
        value = super().number()
        on, off = self._on_off()
        if value not in (on, off):
            raise DeviceError(f"{self.nodes.name}: {self.name} is {value}, neither on ({on}) nor off ({off})")
        return int(value == on)

    def set_number(self, value: Number) -> None:
        on, off = self._on_off()
        super().set_number(on if value else off)

    def set(self, value: bool | str) -> None:
        """Switch it on or off; as words "true" and "false", "on" and "off", or a number."""
        if isinstance(value, str):
            value = {"true": True, "on": True, "false": False, "off": False}.get(value.lower(), value)
        self.set_number(bool(self.stated(value)))

    def minimum(self) -> Number:
        return 0

    def maximum(self) -> Number:
        return 1


class EnumEntry(Node):
    """One choice of an enumeration."""

    def number(self) -> int:
        text = self.description.text("Value")
        try:
            return truncated(parse_number(text or ""))
        except ValueError:
            raise self.broken(f"the choice's value {text!r} is not a number") from None

    def own_access(self) -> Access:
        return Access.READ_ONLY


class Enumeration(Valued):
    """A feature with a set of named values."""

    def __init__(self, description: NodeDescription, nodes: Nodes) -> None:
        super().__init__(description, nodes)
        self.entries: dict[str, EnumEntry] = {}
        """All choices by their names, also those that are not available at present."""
        for item in description.all("EnumEntry"):
            name = item.attributes.get("Name", "")
            described = NodeDescription("EnumEntry", f"{self.name}.{name}", item.children)
            self.entries.setdefault(name, EnumEntry(described, nodes))

    def entry_number(self, entry: str) -> int:
        if entry in self.entries:
            return self.entries[entry].number()
        choices = ", ".join(self.entries)
        raise DeviceError(f"{self.nodes.name}: {self.name} has no choice {entry!r}; choices: {choices}")

    def own_access(self) -> Access:
        """Access of the register; not available if none of the choices is available."""
        mode = super().own_access()
        if mode is Access.NOT_IMPLEMENTED:
            return mode
        without = Access.NOT_IMPLEMENTED
        for node in self.entries.values():
            access = node.access()
            if access.readable:
                return mode  # one available choice is enough; reading the others' registers takes time
            if access is not Access.NOT_IMPLEMENTED:
                without = Access.NOT_AVAILABLE
        return without

    def choices(self) -> tuple[str, ...]:
        """Names of the choices that are available at present."""
        return tuple(name for name, node in self.entries.items() if node.access().readable)

    def number(self) -> int:
        return truncated(super().number())

    def get(self) -> str:
        """Name of the present choice."""
        value = self.number()
        for name, node in self.entries.items():
            if node.number() == value:
                return name
        raise DeviceError(f"{self.nodes.name}: {self.name} is {value}, which is not one of its choices")

    def set(self, value: str) -> None:
        """Select a choice by its name."""
        self.must_be_writable()
        number = self.entry_number(value)
        available = self.choices()
        if value not in available:
            listed = ", ".join(available)
            raise DeviceError(
                f"{self.nodes.name}: {self.name} cannot be {value!r} at present; choices: {listed}"
            )
        self.set_number(number)


class Command(Valued):
    """A command to the camera, executed by writing a value."""

    def execute(self) -> None:
        self.must_be_writable()
        value = self.value_of("CommandValue")
        self.set_number(1 if value is None else value)

    def get(self) -> bool:
        """Whether the camera is still executing the command."""
        source = self.source()
        if source is None or not source.access().readable:
            return False
        value = self.value_of("CommandValue")
        return source.number() == (1 if value is None else value)

    def set(self, value: Any) -> None:
        """Execute the command, whatever the value."""
        self.execute()
