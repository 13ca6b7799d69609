"""Nodes that are features with a number or a text as value, usually contained in a register."""

import math
from typing import Final

from acquisition.cameras.usb3vision.genapi.description import Property
from acquisition.cameras.usb3vision.genapi.node import Access, Node, parse_number
from acquisition.cameras.usb3vision.genapi.operators import Number, truncated
from processing.errors import DeviceError

_INT64_MIN: Final = -(1 << 63)
_INT64_MAX: Final = (1 << 63) - 1


class Valued(Node):
    """A value that is constant, contained in another node, or selected by an index."""

    def source(self) -> Node | None:
        """The node that contains the value at present; None if the value is not in another node."""
        index = self.referred("pIndex")
        if index is not None:
            wanted = truncated(index.number())
            for item in self.description.properties:
                if item.tag == "pValueIndexed" and self._index(item) == wanted:
                    return self.nodes.node(item.text)
            if not any(self._index(item) == wanted for item in self.description.all("ValueIndexed")):
                return self.referred("pValueDefault")
            return None
        return self.referred("pValue")

    def _index(self, item: Property) -> int:
        try:
            return truncated(parse_number(item.attributes.get("Index", "")))
        except ValueError:
            raise self.broken(f"the index {item.attributes.get('Index')!r} is not a number") from None

    def own_number(self) -> Number:
        """A value that is not in another node: as set before, otherwise as stated in the description."""
        if self.name in self.nodes.own_values:
            return self.nodes.own_values[self.name]
        index = self.referred("pIndex")
        text = self.description.text("Value")
        if index is not None:
            wanted = truncated(index.number())
            matching = [i.text for i in self.description.all("ValueIndexed") if self._index(i) == wanted]
            text = matching[0] if matching else self.description.text("ValueDefault")
        if text is None:
            raise self.broken("it has no value")
        try:
            return parse_number(text)
        except ValueError:
            raise self.broken(f"its value {text!r} is not a number") from None

    def own_access(self) -> Access:
        source = self.source()
        mode = Access.READ_WRITE if source is None else source.access()
        for tag in ("pMin", "pMax", "pInc", "pIndex"):
            needed = self.referred(tag)
            if needed is not None:
                mode = mode.where_readable(needed.access())
        return mode

    def number(self) -> Number:
        self.must_be_readable()
        source = self.source()
        return self.own_number() if source is None else source.number()

    def set_number(self, value: Number) -> None:
        self.must_be_writable()
        source = self.source()
        if source is None:
            self.nodes.set_own_value(self, value)
        else:
            source.set_number(value)
        for copy in self.description.all("pValueCopy"):
            self.nodes.node(copy.text).set_number(value)

    def stated(self, value: Number | str) -> Number:
        """A number as a person or a configuration states it: "0x140" too."""
        if not isinstance(value, str):
            return value
        try:
            return parse_number(value)
        except ValueError:
            raise DeviceError(f"{self.nodes.name}: {self.name} = {value!r} is not a number") from None

    def _limit(self, tag: str) -> Number | None:
        own = self.value_of(tag)
        if own is not None:
            return own
        source = self.source()
        if source is None:
            return None
        return {"Min": source.minimum, "Max": source.maximum, "Inc": source.increment}[tag]()

    def check_range(self, value: Number) -> None:
        """Raise DeviceError, which states the range, if the value is not allowed."""
        low, high, step = self.minimum(), self.maximum(), self.increment()
        unit = self.description.text("Unit")
        outside = (low is not None and value < low) or (high is not None and value > high)
        off_step = isinstance(value, int) and isinstance(step, int) and isinstance(low, int)
        if off_step and step and not outside:
            outside = (value - low) % step != 0  # type: ignore[operator]
        if outside or value != value:
            steps = f" in steps of {step:g}" if step is not None and step != 1 else ""
            both = low is not None and high is not None
            span = f"{low:.10g} to {high:.10g}" if both else f"from {low} to {high}"
            allowed = span + (f" {unit}" if unit else "") + steps
            raise DeviceError(
                f"{self.nodes.name}: {self.name} = {value} is out of range; allowed is {allowed}"
            )


class Integer(Valued):
    """An integer with limits and a step."""

    def number(self) -> int:
        return truncated(super().number())

    get = number

    def minimum(self) -> Number:
        limit = self._limit("Min")
        return _INT64_MIN if limit is None else truncated(limit)

    def maximum(self) -> Number:
        limit = self._limit("Max")
        return _INT64_MAX if limit is None else truncated(limit)

    def increment(self) -> Number:
        step = self._limit("Inc")
        return 1 if step is None else truncated(step)

    def set(self, value: int | str) -> None:
        """Set the value; DeviceError, which states the range, if it is not allowed."""
        self.must_be_writable()
        number = self.stated(value)
        if not math.isfinite(number) or number != int(number):
            raise DeviceError(f"{self.nodes.name}: {self.name} = {value} must be a whole number")
        self.check_range(int(number))
        self.set_number(int(number))


class Float(Valued):
    """A floating-point number with limits."""

    def number(self) -> float:
        return float(super().number())

    get = number

    def minimum(self) -> Number | None:
        return self._limit("Min")

    def maximum(self) -> Number | None:
        return self._limit("Max")

    def increment(self) -> Number | None:
        return self.value_of("Inc")

    def set(self, value: float | str) -> None:
        """Set the value; DeviceError, which states the range, if it is not allowed."""
        self.must_be_writable()
        number = float(self.stated(value))
        self.check_range(number)
        self.set_number(number)


class String(Node):
    """A text, of its own or contained in another node."""

    def own_access(self) -> Access:
        source = self.referred("pValue")
        return Access.READ_WRITE if source is None else source.access()

    def get(self) -> str:
        self.must_be_readable()
        source = self.referred("pValue")
        if source is None:
            return self.nodes.own_texts.get(self.name, self.description.text("Value") or "")
        return str(getattr(source, "get", source.number)())

    def set(self, value: str) -> None:
        self.must_be_writable()
        source = self.referred("pValue")
        if source is None:
            self.nodes.own_texts[self.name] = value
        elif hasattr(source, "set"):
            source.set(value)
        else:
            raise self.broken(f"{source.name} does not contain a text")


class Category(Node):
    """A named group of features."""

    def own_access(self) -> Access:
        return Access.READ_ONLY


class Port(Node):
    """The place of registers: the camera itself, or data that are sent with frames (chunks) and events."""

    def own_access(self) -> Access:
        tags = {item.tag for item in self.description.properties}
        if tags & {"ChunkID", "pChunkID"}:
            return Access.NOT_AVAILABLE
        return Access.NOT_IMPLEMENTED if "EventID" in tags else Access.READ_WRITE
