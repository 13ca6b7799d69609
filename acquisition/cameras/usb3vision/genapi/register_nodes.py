"""Nodes that are registers of the camera, read and written through a cache."""

import math
import struct
from typing import Literal

from acquisition.cameras.usb3vision.genapi.description import NodeDescription, Property
from acquisition.cameras.usb3vision.genapi.formula_nodes import SwissKnife
from acquisition.cameras.usb3vision.genapi.node import Access, Node, parse_number
from acquisition.cameras.usb3vision.genapi.operators import Number, rounded, truncated
from processing.errors import DeviceError

# largest length of a register in bytes; a description with a larger one is wrong
_LONGEST = 1 << 24


class Register(Node):
    """A register as bytes; base class of the others.

    The address is the sum of all terms in the description: numbers, values of other nodes, formulas, and
    indices times their offset.
    """

    def own_access(self) -> Access:
        port = self.nodes.port_access(self.description.text("pPort"))
        if not port.readable:
            return port
        mode = super().own_access() if self.description.text("AccessMode") else Access.READ_ONLY
        for item in self.description.properties:
            if item.tag in ("pAddress", "pIndex", "pLength"):
                mode = mode.where_readable(self.nodes.node(item.text).access())
            elif item.tag == "IntSwissKnife":
                mode = mode.where_readable(self._inner_formula(item).access())
        return mode

    def _inner_formula(self, item: Property) -> SwissKnife:
        description = NodeDescription("IntSwissKnife", f"{self.name}.address", item.children)
        return SwissKnife(description, self.nodes)

    def address(self) -> int:
        address = 0
        for item in self.description.properties:
            if item.tag == "Address":
                address += self._whole(item.text)
            elif item.tag == "pAddress":
                address += truncated(self.nodes.node(item.text).number())
            elif item.tag == "IntSwissKnife":
                address += truncated(self._inner_formula(item).number())
            elif item.tag == "pIndex":
                address += truncated(self.nodes.node(item.text).number()) * self._offset(item)
        return address % (1 << 64)

    def _offset(self, index: Property) -> int:
        if "pOffset" in index.attributes:
            return truncated(self.nodes.node(index.attributes["pOffset"]).number())
        if "Offset" in index.attributes:
            return self._whole(index.attributes["Offset"])
        return self.length()

    def _whole(self, text: str) -> int:
        try:
            return truncated(parse_number(text))
        except ValueError:
            raise self.broken(f"{text!r} is not an address") from None

    def length(self) -> int:
        """Number of bytes."""
        length = truncated(self.value_of("Length") or 0)
        if not 0 < length <= _LONGEST:
            raise self.broken(f"a register cannot have {length} bytes")
        return length

    def read_bytes(self) -> bytes:
        """The bytes, from the cache if the description allows it."""
        return self.nodes.read_register(self, self.address(), self.length())

    def write_bytes(self, data: bytes) -> None:
        """Write the bytes; cached values that depend on them become invalid."""
        self.nodes.write_register(self, self.address(), data)

    def _byte_order(self) -> Literal["little", "big"]:
        return "big" if self.description.text("Endianess") == "BigEndian" else "little"

    def get(self) -> bytes:
        self.must_be_readable()
        return self.read_bytes()

    def set(self, value: bytes) -> None:
        self.must_be_writable()
        if len(value) != self.length():
            raise DeviceError(f"{self.nodes.name}: {self.name} has {self.length()} bytes, got {len(value)}")
        self.write_bytes(value)


class IntReg(Register):
    """An integer of one to eight bytes."""

    def _layout(self) -> tuple[int, int, bool]:
        """Lowest bit, number of bits, whether signed."""
        length = self.length()
        if length > 8:
            raise self.broken(f"an integer cannot have {length} bytes")
        return 0, 8 * length, self.description.text("Sign") == "Signed"

    def number(self) -> Number:
        self.must_be_readable()
        lowest, bits, signed = self._layout()
        value = int.from_bytes(self.read_bytes(), self._byte_order()) >> lowest & ((1 << bits) - 1)
        if signed and value >> (bits - 1):
            value -= 1 << bits
        # as a signed 64-bit integer, with which formulas calculate
        return value if value < 1 << 63 else value - (1 << 64)

    get = number  # type: ignore[assignment]

    def minimum(self) -> Number:
        _, bits, signed = self._layout()
        return -(1 << (bits - 1)) if signed else 0

    def maximum(self) -> Number:
        _, bits, signed = self._layout()
        return (1 << (bits - 1)) - 1 if signed or bits == 64 else (1 << bits) - 1

    def increment(self) -> Number:
        return 1

    def set_number(self, value: Number) -> None:
        self.must_be_writable()
        whole = rounded(value)
        if not self.minimum() <= whole <= self.maximum():
            low, high = self.minimum(), self.maximum()
            raise DeviceError(f"{self.nodes.name}: {self.name} = {value} is out of range; {low} to {high}")
        lowest, bits, _ = self._layout()
        mask = ((1 << bits) - 1) << lowest
        length = self.length()
        kept = 0
        if bits < 8 * length and self.own_access().readable:
            kept = int.from_bytes(self.read_bytes(), self._byte_order()) & ~mask
        self.write_bytes((kept | (whole << lowest & mask)).to_bytes(length, self._byte_order()))

    set = set_number  # type: ignore[assignment]


class MaskedIntReg(IntReg):
    """Some bits of a register. Bit 0 is the least significant bit, or the most significant if big-endian."""

    def _layout(self) -> tuple[int, int, bool]:
        _, width, signed = super()._layout()
        bit = self.value_of("Bit")
        first = truncated(bit if bit is not None else self.value_of("LSB") or 0)
        last = truncated(bit if bit is not None else self.value_of("MSB") or 0)
        if self._byte_order() == "big":
            first, last = width - 1 - first, width - 1 - last
        lowest, highest = min(first, last), max(first, last)
        if lowest < 0 or highest >= width:
            raise self.broken(f"bits {lowest} to {highest} of a register of {width} bits")
        return lowest, highest - lowest + 1, signed


class FloatReg(Register):
    """A floating-point number of four or eight bytes."""

    def _format(self) -> str:
        length = self.length()
        if length not in (4, 8):
            raise self.broken(f"a floating-point number cannot have {length} bytes")
        return (">" if self._byte_order() == "big" else "<") + ("f" if length == 4 else "d")

    def number(self) -> Number:
        self.must_be_readable()
        return float(struct.unpack(self._format(), self.read_bytes())[0])

    get = number  # type: ignore[assignment]

    def minimum(self) -> Number:
        return -self.maximum()

    def maximum(self) -> Number:
        return 3.4028234663852886e38 if self.length() == 4 else 1.7976931348623157e308

    def set_number(self, value: Number) -> None:
        self.must_be_writable()
        if not math.isfinite(value) or abs(value) > self.maximum():
            raise DeviceError(
                f"{self.nodes.name}: {self.name} cannot be {value}; its largest value is {self.maximum()}"
            )
        self.write_bytes(struct.pack(self._format(), float(value)))

    set = set_number  # type: ignore[assignment]


class StringReg(Register):
    """A text, which ends with a zero byte or with the register."""

    def text(self) -> str:
        self.must_be_readable()
        return self.read_bytes().split(b"\0", 1)[0].decode("utf-8", "replace")

    get = text  # type: ignore[assignment]

    def set(self, value: str) -> None:  # type: ignore[override]
        self.must_be_writable()
        raw = value.encode()
        if len(raw) > self.length():
            raise DeviceError(
                f"{self.nodes.name}: {self.name} holds {self.length()} bytes, got {len(raw)}: {value!r}"
            )
        self.write_bytes(raw.ljust(self.length(), b"\0"))
