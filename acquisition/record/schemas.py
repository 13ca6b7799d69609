"""Flat protobuf messages, defined by names and kinds of fields: descriptor, encoding, decoding.

Numbers are stored with 64 bits (double, sfixed64). A replay therefore obtains exactly the recorded values,
and all messages of numbers have the same length, so that many can be encoded and decoded at once with numpy.
The descriptor is stored in the file, so that viewers can plot the fields.
"""

import dataclasses
import struct
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, get_type_hints

import numpy as np
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from acquisition.record.descriptor import PROTO_TYPE, Kind, Meanings, descriptor_of

_KIND: dict[int, Kind] = {number: kind for kind, number in PROTO_TYPE.items()}
_DEFAULT: dict[Kind, Any] = {"double": 0.0, "int": 0, "text": "", "bytes": b""}
_NUMPY: dict[Kind, str] = {"double": "<f8", "int": "<i8"}
_MORE_FIELDS = 256
"""Fields of a later version that a message may have; more would only keep a reader busy."""
_WIRE_VARINT, _WIRE_FIXED64, _WIRE_LENGTH, _WIRE_FIXED32 = 0, 1, 2, 5


@dataclass(frozen=True)
class MessageType:
    """A protobuf message: the numbers first, then texts or bytes (`tail`); field numbers count from 1.

    `about` and `meanings` go into the description that is stored in a file.
    """

    full_name: str
    topic: str
    numbers: tuple[tuple[str, Kind], ...]
    tail: tuple[tuple[str, Kind], ...] = ()
    about: str = dataclasses.field(default="", compare=False)
    meanings: tuple[Meanings, ...] = dataclasses.field(default=(), compare=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields in order."""
        return tuple(name for name, _ in (*self.numbers, *self.tail))

    @cached_property
    def descriptor(self) -> bytes:
        """Serialised FileDescriptorSet, as it is stored in MCAP files."""
        return descriptor_of(self.full_name, (*self.numbers, *self.tail), self.about, self.meanings)

    @cached_property
    def table_dtype(self) -> np.dtype[Any]:
        """Type of the rows of `decode_table`: one field per number."""
        return np.dtype([(name, _NUMPY[kind]) for name, kind in self.numbers])

    @cached_property
    def wire_dtype(self) -> np.dtype[Any]:
        """Type of the encoded numbers: each field preceded by its tag."""
        fields: list[Any] = []
        for number, (name, kind) in enumerate(self.numbers, start=1):
            tag = _varint(number << 3 | _WIRE_FIXED64)
            fields += [(f"tag {name}", f"V{len(tag)}"), (name, _NUMPY[kind])]
        return np.dtype(fields)

    @cached_property
    def _tags(self) -> list[bytes]:
        return [_varint(number << 3 | _WIRE_FIXED64) for number in range(1, len(self.numbers) + 1)]

    @cached_property
    def _layout(self) -> tuple[struct.Struct, list[Any]]:
        """Format of the encoded numbers for `struct`, and its arguments, with None in place of the values."""
        form = "<" + "".join(
            f"{len(tag)}s{'d' if kind == 'double' else 'q'}"
            for tag, (_, kind) in zip(self._tags, self.numbers, strict=True)
        )
        arguments: list[Any] = [None] * (2 * len(self._tags))
        arguments[0::2] = self._tags
        return struct.Struct(form), arguments

    @cached_property
    def _tail_tags(self) -> list[bytes]:
        first = len(self.numbers) + 1
        return [_varint(number << 3 | _WIRE_LENGTH) for number in range(first, first + len(self.tail))]

    def encode(self, *values: Any) -> bytes:
        """Encode a message from the values of its fields in order: numbers, then texts and bytes."""
        layout, template = self._layout
        count = len(self.numbers)
        arguments = template.copy()
        arguments[1::2] = values[:count]
        head = layout.pack(*arguments)
        if not self.tail:
            return head
        parts = [head]
        for tag, value in zip(self._tail_tags, values[count:], strict=True):
            data = value.encode() if isinstance(value, str) else value
            parts += [tag, _varint(len(data)), data]
        return b"".join(parts)

    def wire_rows(self, count: int) -> NDArray[Any]:
        """Array (count,) of `wire_dtype` for encoded messages without tail; tags are set, numbers are 0."""
        row = np.zeros(1, dtype=self.wire_dtype)
        for tag, (name, _) in zip(self._tags, self.numbers, strict=True):
            row[f"tag {name}"] = np.void(tag)
        return np.repeat(row, count)

    def decode(self, data: bytes) -> tuple[Any, ...]:
        """Values of the fields in order, from any valid encoding; an absent field has the default of proto3.

        Raises ValueError if the bytes are not such a message.
        """
        kinds = [kind for _, kind in (*self.numbers, *self.tail)]
        values = [_DEFAULT[kind] for kind in kinds]
        place, end, most_fields = 0, len(data), 2 * len(kinds) + _MORE_FIELDS
        layout, _ = self._layout
        if end >= layout.size:
            # messages encoded by this module contain all numbers, in order
            head = layout.unpack_from(data)
            if list(head[0::2]) == self._tags:
                values[: len(self.numbers)] = head[1::2]
                place = layout.size
        try:
            while place < end:
                key, place = _read_varint(data, place)
                most_fields -= 1
                if key < 8 or most_fields < 0:
                    raise ValueError(f"{self.full_name}: is not such a message")
                field, wire = (key >> 3) - 1, key & 7
                known = 0 <= field < len(kinds)
                if wire == _WIRE_FIXED64:
                    if known:
                        code = "<d" if kinds[field] == "double" else "<q"
                        values[field] = struct.unpack_from(code, data, place)[0]
                    place += 8
                elif wire == _WIRE_LENGTH:
                    length, place = _read_varint(data, place)
                    raw, place = data[place : place + length], place + length
                    if known:
                        values[field] = raw.decode() if kinds[field] == "text" else raw
                elif wire == _WIRE_VARINT:
                    _, place = _read_varint(data, place)
                elif wire == _WIRE_FIXED32:
                    place += 4
                else:
                    raise ValueError(f"wire type {wire} is unknown")
        except (IndexError, struct.error):
            place = end + 1
        if place != end:
            raise ValueError(f"{self.full_name}: message of {end} bytes ends inside a field")
        return tuple(values)

    def decode_table(
        self, messages: NDArray[np.void] | Sequence[bytes], names: Collection[str] | None = None
    ) -> NDArray[Any]:
        """The numbers of many messages as a structured array (n,), of all fields or of those in `names`.

        Messages of equal length may be the items of an array, which is faster.
        """
        wanted = [(name, kind) for name, kind in self.numbers if names is None or name in names]
        wire = self._as_written(messages)
        if wire is None:
            wire = self.wire_rows(len(messages))
            columns = zip(*[self.decode(bytes(data)) for data in messages], strict=True)
            for (name, _), column in zip(self.numbers, columns, strict=False):
                wire[name] = column
        table = np.empty(len(wire), dtype=[(name, _NUMPY[kind]) for name, kind in wanted])
        for name, _ in wanted:
            table[name] = wire[name]
        return table

    def _as_written(self, messages: NDArray[np.void] | Sequence[bytes]) -> NDArray[Any] | None:
        """The messages as rows of `wire_dtype`, if they are encoded as we write them; otherwise None."""
        size = self.wire_dtype.itemsize
        if not isinstance(messages, np.ndarray):
            if any(len(message) != size for message in messages):
                return None
            messages = np.frombuffer(b"".join(messages), dtype=f"V{size}")
        if self.tail or messages.dtype.itemsize != size:
            return None
        found = messages.view(np.uint8).reshape(len(messages), size)[:, self._tag_bytes]
        as_ours = np.array_equal(found, np.broadcast_to(self._all_tags, found.shape))
        return messages.view(self.wire_dtype) if as_ours else None

    @cached_property
    def _all_tags(self) -> NDArray[np.uint8]:
        return np.frombuffer(b"".join(self._tags), dtype=np.uint8)

    @cached_property
    def _tag_bytes(self) -> NDArray[np.intp]:
        """Which bytes of an encoded message are tags."""
        row = np.zeros(1, dtype=self.wire_dtype)
        for tag, (name, _) in zip(self._tags, self.numbers, strict=True):
            row[f"tag {name}"] = np.void(b"\xff" * len(tag))
        return np.flatnonzero(row.view(np.uint8))


def parse_message_type(full_name: str, topic: str, descriptor: bytes) -> MessageType:
    """Message type from the descriptor in a file.

    Raises ValueError if the descriptor is damaged, or not that of a flat message with 64-bit numbers.
    """
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(descriptor)
    except DecodeError:
        raise ValueError(f"{full_name}: its descriptor cannot be read") from None
    found = [
        message
        for file in files.file
        for message in file.message_type
        if f"{file.package}.{message.name}" == full_name
    ]
    if not found:
        raise ValueError(f"{full_name}: its descriptor does not describe it")
    fields = sorted(found[0].field, key=lambda field: field.number)
    kinds = [_KIND.get(field.type) for field in fields]
    numeric = [kind in _NUMPY for kind in kinds]
    in_order = [field.number for field in fields] == list(range(1, len(fields) + 1))
    names = [field.name for field in fields]
    named_apart = len(set(names)) == len(names) and all(str(name).isidentifier() for name in names)
    if None in kinds or not (in_order and named_apart) or numeric != sorted(numeric, reverse=True):
        raise ValueError(f"{full_name}: is not a flat message of fixed-width numbers")
    named = tuple((field.name, kind) for field, kind in zip(fields, kinds, strict=True) if kind is not None)
    count = sum(numeric)
    return MessageType(full_name, topic, named[:count], named[count:])


def message_type_of(value_class: type, full_name: str, topic: str) -> MessageType:
    """Message type of a flat dataclass or NamedTuple whose fields are int, bool, float or str.

    Texts are placed after the numbers, otherwise the order is kept. Raises TypeError for other fields.
    """
    hints = get_type_hints(value_class)
    numbers: list[tuple[str, Kind]] = []
    tail: list[tuple[str, Kind]] = []
    for name in _field_names(value_class):
        kind = hints[name]
        if isinstance(kind, type) and issubclass(kind, int):
            numbers.append((name, "int"))
        elif kind is float:
            numbers.append((name, "double"))
        elif kind is str:
            tail.append((name, "text"))
        else:
            raise TypeError(f"{value_class.__name__}.{name}: {kind} cannot be recorded")
    return MessageType(
        full_name, topic, tuple(numbers), tuple(tail), " ".join((value_class.__doc__ or "").split())
    )


def _field_names(value_class: type) -> Iterable[str]:
    if dataclasses.is_dataclass(value_class):
        return [field.name for field in dataclasses.fields(value_class)]
    names: Iterable[str] | None = getattr(value_class, "_fields", None)
    if names is None:
        raise TypeError(f"{value_class.__name__}: only a dataclass or a NamedTuple can be recorded")
    return names


def length_delimited(number: int, length: int) -> bytes:
    """Tag and length that precede the bytes of a text, bytes or message field."""
    return _varint(number << 3 | _WIRE_LENGTH) + _varint(length)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _read_varint(data: bytes, place: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
        shift += 7
        if shift > 63:
            raise ValueError("a number of more than 64 bits")
