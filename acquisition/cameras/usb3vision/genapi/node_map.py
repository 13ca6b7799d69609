"""All features of one camera, the cache of their registers, and what a write makes stale."""

import time
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol

from acquisition.cameras.usb3vision.genapi.choice_nodes import Boolean, Command, EnumEntry, Enumeration
from acquisition.cameras.usb3vision.genapi.description import NodeDescription, parse_description
from acquisition.cameras.usb3vision.genapi.formula_nodes import Converter, SwissKnife
from acquisition.cameras.usb3vision.genapi.node import Access, Node
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
    """Where registers are read and written: a camera's control channel, or memory in a test."""

    def read(self, address: int, length: int) -> bytes:
        """Bytes from an address."""
        ...

    def write(self, address: int, data: bytes) -> None:
        """Bytes to an address."""
        ...


class NodeMap:
    """The features of a camera by name.

    Parameters
    ----------
    xml
        The camera's description.
    port
        Its registers.
    name
        What messages call the camera.
    clock
        Monotonic time in s, for registers that the description wants polled.

    Raises
    ------
    DeviceError
        Malformed description.
    """

    def __init__(
        self, xml: str, port: RegisterPort, name: str, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.name = name
        self.own_values: dict[str, Number] = {}
        self.own_texts: dict[str, str] = {}
        self.asking: set[str] = set()  # nodes whose access is being found out
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
        """The node with this name; DeviceError where the camera has none."""
        if name not in self._nodes:
            description = self._descriptions.get(name)
            if description is None:
                raise DeviceError(f"{self.name}: has no feature {name!r}")
            self._nodes[name] = _KINDS.get(description.kind, Node)(description, self)
        return self._nodes[name]

    def get(self, name: str) -> Any:
        """A feature's value: int, float, bool, or str for texts and choices."""
        node = self.node(name)
        if not hasattr(node, "get"):
            raise DeviceError(f"{self.name}: {name} is a {node.description.kind} and has no value")
        try:
            return node.get()
        except RecursionError:
            raise node.broken("it refers to itself") from None

    def set(self, name: str, value: Any) -> None:
        """Set a feature."""
        node = self.node(name)
        if not hasattr(node, "set"):
            raise DeviceError(f"{self.name}: {name} is a {node.description.kind} and can't be set")
        try:
            node.set(value)
        except RecursionError:
            raise node.broken("it refers to itself") from None

    def features(self) -> tuple[str, ...]:
        """Names of all that stands under a category: what a user may care for."""
        found: dict[str, None] = {}
        for name, description in self._descriptions.items():
            if description.kind == "Category":
                found.update(dict.fromkeys(i.text for i in description.all("pFeature") if i.text in self))
                del name
        return tuple(name for name in found if self._descriptions[name].kind != "Category")

    # ---- registers

    def port_access(self, name: str | None) -> Access:
        """Full where the port is the camera; events and chunk data have ports that nobody reads here."""
        if name is None or name not in self:
            return Access.NOT_IMPLEMENTED
        node = self.node(name)
        return node.access() if isinstance(node, Port) else Access.NOT_IMPLEMENTED

    def read_register(self, register: Node, address: int, length: int) -> bytes:
        """A register's bytes, from the cache where that is allowed and fresh."""
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
        """Write, and forget every register that depends on this one or shares bytes with it."""
        self._port.write(address, data)
        stale = self._stale_after(register.name)
        end = address + len(data)
        self._cache = {
            key: entry
            for key, entry in self._cache.items()
            if key[0] not in stale and (key[1] >= end or key[1] + key[2] <= address)
        }
        if register.description.text("Cachable") in (None, "WriteThrough") and register.own_access().readable:
            # "Write through": what was written counts as what is there, until something invalidates it.
            # Reading back is the caller's decision, with `forget` before it.
            self._cache[(register.name, address, len(data))] = (data, float("inf"))

    def set_own_value(self, node: Node, value: Number) -> None:
        """Set a value that no register holds."""
        self.own_values[node.name] = value
        stale = self._stale_after(node.name)
        self._cache = {key: entry for key, entry in self._cache.items() if key[0] not in stale}

    def forget(self) -> None:
        """Read everything from the camera again."""
        self._cache.clear()

    def _stale_after(self, name: str) -> frozenset[str]:
        """This node and all whose value can follow from it, through whatever references."""
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
