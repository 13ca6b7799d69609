"""Base class of all nodes of a description: access, references to other nodes, value."""

from collections.abc import Callable
from enum import Enum
from typing import ClassVar, Protocol

from acquisition.cameras.usb3vision.genapi.description import NodeDescription
from acquisition.cameras.usb3vision.genapi.operators import Number
from processing.errors import DeviceError


class Access(Enum):
    """Whether a node can be read and written at present."""

    NOT_IMPLEMENTED = "not implemented"
    NOT_AVAILABLE = "not available at present"
    READ_ONLY = "read-only"
    WRITE_ONLY = "write-only"
    READ_WRITE = "readable and writable"

    @property
    def readable(self) -> bool:
        return self in (Access.READ_ONLY, Access.READ_WRITE)

    @property
    def writable(self) -> bool:
        return self in (Access.WRITE_ONLY, Access.READ_WRITE)

    def and_also(self, other: "Access") -> "Access":
        """Access that both allow."""
        for absent in (Access.NOT_IMPLEMENTED, Access.NOT_AVAILABLE):
            if absent in (self, other):
                return absent
        return _ACCESS[self.readable and other.readable, self.writable and other.writable]

    def where_readable(self, needed: "Access") -> "Access":
        """This access, if the value of another node, whose access is `needed`, is required for it."""
        if needed.readable or self is Access.NOT_IMPLEMENTED:
            return self
        return needed if needed is Access.NOT_IMPLEMENTED else Access.NOT_AVAILABLE


_ACCESS = {
    (True, True): Access.READ_WRITE,
    (True, False): Access.READ_ONLY,
    (False, True): Access.WRITE_ONLY,
    (False, False): Access.NOT_AVAILABLE,
}
_ACCESS_BY_NAME = {"RO": Access.READ_ONLY, "WO": Access.WRITE_ONLY, "RW": Access.READ_WRITE}


class AccessRefused(DeviceError):
    """A feature cannot be read or set, at present or in general."""


def parse_number(text: str) -> Number:
    """A number in a description: decimal or hexadecimal integer, or float. Raises ValueError."""
    text = text.strip()
    try:
        return int(text, 16) if text[:2].lower() == "0x" else int(text)
    except ValueError:
        return float(text)


class NodeReading:
    """One reading from outside, in which many nodes refer to the same ones: each is determined once.

    Without this, a chain of formulas with two references each would be read 2^length times. `asking` are the
    nodes whose access is being determined; what is found while a circle is open is not kept.
    """

    def __init__(self) -> None:
        self.asking: set[str] = set()
        self._accesses: dict[str, Access] = {}
        self._numbers: dict[str, Number] = {}
        self._calculating = 0
        self._in_circle = False

    def access(self, name: str, determine: Callable[[], Access]) -> Access:
        """Access of the node with this name."""
        if name in self._accesses:
            return self._accesses[name]
        if name in self.asking:
            # some descriptions contain circular references, for which EMVA's reference gives the same result
            self._in_circle = True
            return Access.READ_WRITE
        self.asking.add(name)
        try:
            mode = determine()
            if not self._in_circle:
                self._accesses[name] = mode
            return mode
        finally:
            self.asking.discard(name)
            self._end()

    def number(self, name: str, calculate: Callable[[], Number]) -> Number:
        """Value of the node with this name, which is calculated from others."""
        if name not in self._numbers:
            self._calculating += 1
            try:
                self._numbers[name] = calculate()
                return self._numbers[name]
            finally:
                self._calculating -= 1
                self._end()
        return self._numbers[name]

    def _end(self) -> None:
        if not self.asking:
            self._in_circle = False
            if not self._calculating:
                self._accesses.clear()
                self._numbers.clear()


class Nodes(Protocol):
    """Interface of `node_map.NodeMap` to its nodes, declared here because that module imports this one.

    `name` is the name of the camera in messages. `own_values` and `own_texts` contain, by the name of the
    node, values that are not in a register. `look` is the reading that is going on.
    """

    name: str
    own_values: dict[str, Number]
    own_texts: dict[str, str]
    look: "NodeReading"

    def node(self, name: str) -> "Node":
        """The node with this name; DeviceError if the camera has none."""
        ...

    def port_access(self, name: str | None) -> Access:
        """Access to the registers of a port."""
        ...

    def read_register(self, register: "Node", address: int, length: int) -> bytes:
        """Bytes of a register, from the cache if the description allows it and they are still valid."""
        ...

    def write_register(self, register: "Node", address: int, data: bytes) -> None:
        """Write a register; cached values that depend on it or share bytes with it become invalid."""
        ...

    def set_own_value(self, node: "Node", value: Number) -> None:
        """Set a value that is not in a register."""
        ...


class Node:
    """One node; subclasses implement the kinds.

    ``number`` and ``set_number`` are implemented by every kind to whose value another node may refer.
    """

    # references to nodes that do not influence the value of this one
    _NO_INPUTS: ClassVar = {"pFeature", "pSelected", "pAlias", "pCastAlias", "pPort", "pError"}

    def __init__(self, description: NodeDescription, nodes: Nodes) -> None:
        self.name = description.name
        self.description = description
        self.nodes = nodes

    # ---- references

    def inputs(self) -> set[str]:
        """Names of the nodes on which the value of this one depends."""
        found: set[str] = set()
        pending = list(self.description.properties)
        while pending:
            item = pending.pop()
            pending.extend(item.children)
            if item.tag.startswith("p") and item.tag[1:2].isupper() and item.tag not in self._NO_INPUTS:
                found.add(item.text)
            if "pOffset" in item.attributes:
                found.add(item.attributes["pOffset"])
        return found

    def referred(self, tag: str) -> "Node | None":
        """The node that this property refers to; None without the property."""
        name = self.description.text(tag)
        return None if name is None else self.nodes.node(name)

    def value_of(self, tag: str) -> Number | None:
        """Value of a property, stated as ``tag`` or by reference to a node as ``ptag``; None without
        either.
        """
        node = self.referred("p" + tag)
        if node is not None:
            return node.number()
        text = self.description.text(tag)
        if text is None:
            return None
        try:
            return parse_number(text)
        except ValueError:
            raise self.broken(f"its {tag} {text!r} is not a number") from None

    def broken(self, problem: str) -> DeviceError:
        """The exception for an error in the camera's description."""
        return DeviceError(f"{self.nodes.name}: wrong description of the feature {self.name}: {problem}")

    # ---- access

    def access(self) -> Access:
        """Present access; the flags and registers on which it depends are read."""
        return self.nodes.look.access(self.name, self._access)

    def _access(self) -> Access:
        mode = Access.READ_WRITE
        for tag, absent in (
            ("pIsImplemented", Access.NOT_IMPLEMENTED),
            ("pIsAvailable", Access.NOT_AVAILABLE),
        ):
            flag = self.referred(tag)
            if flag is not None:
                mode = mode.where_readable(flag.access())
                if mode is Access.NOT_IMPLEMENTED:
                    return mode
                if mode.readable and flag.number() == 0:
                    mode = absent
        # a node is not implemented if the one that contains its value is not, whatever the flags say
        mode = mode.and_also(self.own_access())
        imposed = self.description.text("ImposedAccessMode")
        if imposed is not None:
            mode = mode.and_also(_ACCESS_BY_NAME.get(imposed, Access.READ_WRITE))
        lock = self.referred("pIsLocked") if mode.writable else None
        if lock is not None and lock.access().readable and lock.number() != 0:
            mode = Access.READ_ONLY if mode.readable else Access.NOT_AVAILABLE
        return mode

    def own_access(self) -> Access:
        """Access that follows from the kind of node, without flags and locks."""
        mode = self.description.text("AccessMode")
        return Access.READ_WRITE if mode is None else _ACCESS_BY_NAME.get(mode, Access.READ_ONLY)

    def must_be_readable(self) -> None:
        """Raise AccessRefused if it cannot be read at present."""
        mode = self.access()
        if not mode.readable:
            raise AccessRefused(f"{self.nodes.name}: {self.name} cannot be read: it is {mode.value}")

    def must_be_writable(self) -> None:
        """Raise AccessRefused if it cannot be set at present."""
        mode = self.access()
        if not mode.writable:
            raise AccessRefused(f"{self.nodes.name}: {self.name} cannot be set: it is {mode.value}")

    # ---- value

    def number(self) -> Number:
        """Value as a number."""
        raise self.broken(f"a {self.description.kind} was used as a number")

    def set_number(self, value: Number) -> None:
        """Set the value from a number."""
        raise self.broken(f"a {self.description.kind} was set to a number ({value})")

    def minimum(self) -> Number | None:
        """Smallest value allowed at present; None if unknown."""
        return None

    def maximum(self) -> Number | None:
        """Largest value allowed at present; None if unknown."""
        return None

    def increment(self) -> Number | None:
        """Step between allowed values; None if unknown."""
        return None

    def entry_number(self, entry: str) -> Number:
        """Number of one choice of an enumeration."""
        raise self.broken(f"it has no choice {entry!r}")
