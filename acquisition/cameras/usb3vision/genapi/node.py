"""What all nodes of a description share: who may read and write them, and what they refer to."""

from enum import Enum
from typing import ClassVar, Protocol

from acquisition.cameras.usb3vision.genapi.description import NodeDescription
from acquisition.cameras.usb3vision.genapi.operators import Number
from processing.errors import DeviceError


class Access(Enum):
    """What may be done with a node at this moment: (readable, writable) where it exists at all."""

    NOT_IMPLEMENTED = "not implemented"
    NOT_AVAILABLE = "not available at present"
    READ_ONLY = "read-only"
    WRITE_ONLY = "write-only"
    READ_WRITE = "readable and writable"

    @property
    def readable(self) -> bool:
        """It has a value that can be read."""
        return self in (Access.READ_ONLY, Access.READ_WRITE)

    @property
    def writable(self) -> bool:
        """It can be set."""
        return self in (Access.WRITE_ONLY, Access.READ_WRITE)

    def and_also(self, other: "Access") -> "Access":
        """What remains when both must agree."""
        for absent in (Access.NOT_IMPLEMENTED, Access.NOT_AVAILABLE):
            if absent in (self, other):
                return absent
        return _ACCESS[self.readable and other.readable, self.writable and other.writable]

    def where_readable(self, needed: "Access") -> "Access":
        """What remains of this access when it takes the value of another node."""
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
    """A feature was read or set that may not be, at present or ever."""


def parse_number(text: str) -> Number:
    """A number as descriptions write it: decimal, hexadecimal, or with a point."""
    text = text.strip()
    try:
        return int(text, 16) if text[:2].lower() == "0x" else int(text)
    except ValueError:
        return float(text)


class Nodes(Protocol):
    """What a node needs of all the others: `node_map.NodeMap`, which makes the nodes and so imports them.

    `name` is what messages call the camera; `own_values` and `own_texts` hold by a node's name what no
    register holds; `asking` names the nodes whose access is being found out.
    """

    name: str
    own_values: dict[str, Number]
    own_texts: dict[str, str]
    asking: set[str]

    def node(self, name: str) -> "Node":
        """The node with this name; DeviceError where the camera has none."""
        ...

    def port_access(self, name: str | None) -> Access:
        """What may be done with the registers behind a port."""
        ...

    def read_register(self, register: "Node", address: int, length: int) -> bytes:
        """A register's bytes, from the cache where that is allowed and fresh."""
        ...

    def write_register(self, register: "Node", address: int, data: bytes) -> None:
        """Write, and forget every register that depends on this one or shares bytes with it."""
        ...

    def set_own_value(self, node: "Node", value: Number) -> None:
        """Set a value that no register holds."""
        ...


class Node:
    """One node; its kind decides what it can do.

    ``number`` and ``set_number`` exist for every kind that another may refer to as a value.
    """

    # References to nodes that do not feed this node's value
    _NO_INPUTS: ClassVar = {"pFeature", "pSelected", "pAlias", "pCastAlias", "pPort", "pError"}

    def __init__(self, description: NodeDescription, nodes: Nodes) -> None:
        self.name = description.name
        self.description = description
        self.nodes = nodes

    # ---- what it refers to

    def inputs(self) -> set[str]:
        """Names of the nodes whose change can change this one."""
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
        """The node that this property names."""
        name = self.description.text(tag)
        return None if name is None else self.nodes.node(name)

    def value_of(self, tag: str) -> Number | None:
        """A property that is either written as ``tag`` or read from the node that ``ptag`` names."""
        node = self.referred("p" + tag)
        if node is not None:
            return node.number()
        text = self.description.text(tag)
        if text is None:
            return None
        try:
            return parse_number(text)
        except ValueError:
            raise self.broken(f"its {tag} {text!r} is no number") from None

    def broken(self, problem: str) -> DeviceError:
        """An error of the description, not of the user."""
        return DeviceError(f"{self.nodes.name}: feature {self.name} is described wrongly: {problem}")

    # ---- access

    def access(self) -> Access:
        """What may be done with it now; flags and registers it depends on are read for that."""
        if self.name in self.nodes.asking:
            return Access.READ_WRITE  # real descriptions have circles here; the reference breaks them so
        self.nodes.asking.add(self.name)
        try:
            return self._access()
        finally:
            self.nodes.asking.discard(self.name)

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
        # What is not implemented underneath is not implemented here, available or not.
        mode = mode.and_also(self.own_access())
        imposed = self.description.text("ImposedAccessMode")
        if imposed is not None:
            mode = mode.and_also(_ACCESS_BY_NAME.get(imposed, Access.READ_WRITE))
        lock = self.referred("pIsLocked") if mode.writable else None
        if lock is not None and lock.access().readable and lock.number() != 0:
            mode = Access.READ_ONLY if mode.readable else Access.NOT_AVAILABLE
        return mode

    def own_access(self) -> Access:
        """Access as far as the kind of node decides."""
        mode = self.description.text("AccessMode")
        return Access.READ_WRITE if mode is None else _ACCESS_BY_NAME.get(mode, Access.READ_ONLY)

    def must_be_readable(self) -> None:
        """Raise AccessRefused where it has no value now."""
        mode = self.access()
        if not mode.readable:
            raise AccessRefused(f"{self.nodes.name}: {self.name} can't be read: it is {mode.value}")

    def must_be_writable(self) -> None:
        """Raise AccessRefused where it can't be set now."""
        mode = self.access()
        if not mode.writable:
            raise AccessRefused(f"{self.nodes.name}: {self.name} can't be set: it is {mode.value}")

    # ---- value

    def number(self) -> Number:
        """Its value as a number."""
        raise self.broken(f"a {self.description.kind} was used as a number")

    def set_number(self, value: Number) -> None:
        """Set it from a number."""
        raise self.broken(f"a {self.description.kind} was set to a number ({value})")

    def minimum(self) -> Number | None:
        """Smallest value allowed now; None where nothing is said."""
        return None

    def maximum(self) -> Number | None:
        """Largest value allowed now."""
        return None

    def increment(self) -> Number | None:
        """Step between allowed values."""
        return None

    def entry_number(self, entry: str) -> Number:
        """The number behind one choice of an enumeration."""
        raise self.broken(f"has no choice {entry!r}")
