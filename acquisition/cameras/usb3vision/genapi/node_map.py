"""All features of one camera, with a cache of their registers that is invalidated by writes."""

import time
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol

from acquisition.cameras.usb3vision.genapi.choice_nodes import Boolean, Command, EnumEntry, Enumeration
from acquisition.cameras.usb3vision.genapi.description import NodeDescription, parse_description
from acquisition.cameras.usb3vision.genapi.formula_nodes import Converter, SwissKnife
from acquisition.cameras.usb3vision.genapi.node import Access, Node, NodeReading
from acquisition.cameras.usb3vision.genapi.operators import Number
from acquisition.cameras.usb3vision.genapi.register_nodes import (
    FloatReg,
    IntReg,
    MaskedIntReg,
    Register,
    StringReg,
)
from acquisition.cameras.usb3vision.genapi.value_nodes import Category, Float, Integer, Port, String
from processing.errors import DeviceError

_KINDS: Final[dict[str, Callable[[NodeDescription, "NodeMap"], Node]]] = {
    "Register": Register,
    "IntReg": IntReg,
    "MaskedIntReg": MaskedIntReg,
    "FloatReg": FloatReg,
    "StringReg": StringReg,
    "Integer": Integer,
    "Float": Float,
    "Boolean": Boolean,
    "Enumeration": Enumeration,
    "EnumEntry": EnumEntry,
    "Command": Command,
    "String": String,
    "SwissKnife": SwissKnife,
    "IntSwissKnife": SwissKnife,
    "Converter": Converter,
    "IntConverter": Converter,
    "Category": Category,
    "Port": Port,
}


class RegisterPort(Protocol):
    """Access to registers: a camera's control channel, or memory in a test."""

    def read(self, address: int, length: int) -> bytes:
        """Read bytes from an address."""
        ...

    def write(self, address: int, data: bytes) -> None:
        """Write bytes to an address."""
        ...


class NodeMap:
    """The features of a camera by name.

    Parameters
    ----------
    xml
        The camera's description.
    port
        Access to its registers.
    name
        Name of the camera in messages.
    clock
        Monotonic time in s, for registers whose cached value is valid for a polling time only.

    Raises
    ------
    DeviceError
        The description is malformed.
    """

    def __init__(
        self, xml: str, port: RegisterPort, name: str, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.name = name
        self.own_values: dict[str, Number] = {}
        self.own_texts: dict[str, str] = {}
        self.look = NodeReading()
        self._descriptions = parse_description(xml, name)
        self._port = port
        self._clock = clock
        self._nodes: dict[str, Node] = {}
        self._cache: dict[tuple[str, int, int], tuple[bytes, float]] = {}
        self._dependents: dict[str, set[str]] | None = None
        self._stale: dict[str, frozenset[str]] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._descriptions

    def __iter__(self) -> Iterator[str]:
        return iter(self._descriptions)

    def node(self, name: str) -> Node:
        """The node with this name; DeviceError if the camera has none."""
        if name not in self._nodes:
            description = self._descriptions.get(name)
            if description is None:
                raise DeviceError(f"{self.name}: has no feature {name!r}")
            self._nodes[name] = _KINDS.get(description.kind, Node)(description, self)
        return self._nodes[name]

    def get(self, name: str) -> Any:
        """Value of a feature: int, float, bool, bytes (a register), or str (a text or a choice).

        Raises DeviceError if the feature does not exist or cannot be read.
        """
        node = self.node(name)
        if not hasattr(node, "get"):
            raise DeviceError(f"{self.name}: {name} is a {node.description.kind} and has no value")
        try:
            return node.get()
        except RecursionError:
            raise node.broken("it refers to itself") from None

    def set(self, name: str, value: Any) -> None:
        """Set a feature; DeviceError if it does not exist, cannot be set, or the value is not allowed."""
        node = self.node(name)
        if not hasattr(node, "set"):
            raise DeviceError(f"{self.name}: {name} is a {node.description.kind} and cannot be set")
        try:
            node.set(value)
        except RecursionError:
            raise node.broken("it refers to itself") from None

    def features(self) -> tuple[str, ...]:
        """Names of all features in a category, which are those meant for users."""
        categories = (node for node in self._descriptions.values() if node.kind == "Category")
        found = dict.fromkeys(item.text for node in categories for item in node.all("pFeature"))
        return tuple(name for name in found if name in self and self._descriptions[name].kind != "Category")

    # ---- registers

    def port_access(self, name: str | None) -> Access:
        """Access to the registers of a port; the ports of events and chunk data are not implemented."""
        if name is None or name not in self:
            return Access.NOT_IMPLEMENTED
        node = self.node(name)
        return node.access() if isinstance(node, Port) else Access.NOT_IMPLEMENTED

    def read_register(self, register: Node, address: int, length: int) -> bytes:
        """Bytes of a register, from the cache if the description allows it and they are still valid."""
        key = (register.name, address, length)
        now_s = self._clock()
        cached = self._cache.get(key)
        if cached is not None and now_s < cached[1]:
            return cached[0]
        data = self._port.read(address, length)
        if register.description.text("Cachable") != "NoCache":
            polling_ms = register.description.text("PollingTime")
            fresh_s = float(polling_ms) / 1000.0 if polling_ms and polling_ms.isdigit() else float("inf")
            self._cache[key] = (data, now_s + fresh_s)
        return data

    def write_register(self, register: Node, address: int, data: bytes) -> None:
        """Write a register; cached values that depend on it or share bytes with it become invalid."""
        self._port.write(address, data)
        stale = self._stale_after(register.name)
        end = address + len(data)
        self._cache = {
            key: entry
            for key, entry in self._cache.items()
            if key[0] not in stale and (key[1] >= end or key[1] + key[2] <= address)
        }
        if register.description.text("Cachable") in (None, "WriteThrough") and register.own_access().readable:
            # "WriteThrough": the value written is taken as the register's value until it becomes invalid;
            # to read it back from the camera, call `forget` first
            self._cache[(register.name, address, len(data))] = (data, float("inf"))

    def set_own_value(self, node: Node, value: Number) -> None:
        """Set a value that is not in a register."""
        self.own_values[node.name] = value
        stale = self._stale_after(node.name)
        self._cache = {key: entry for key, entry in self._cache.items() if key[0] not in stale}

    def forget(self) -> None:
        """Empty the cache, so that every value is read from the camera again."""
        self._cache.clear()

    def _stale_after(self, name: str) -> frozenset[str]:
        """Names of this node and of all nodes whose value depends on it, directly or indirectly."""
        if self._dependents is None:
            self._dependents = {}
            for other in self._descriptions:
                for used in self.node(other).inputs():
                    self._dependents.setdefault(used, set()).add(other)
        if name not in self._stale:
            found, pending = {name}, [name]
            while pending:
                for dependent in self._dependents.get(pending.pop(), ()):
                    if dependent not in found:
                        found.add(dependent)
                        pending.append(dependent)
            self._stale[name] = frozenset(found)
        return self._stale[name]
