"""Flat protobuf messages, defined by names and kinds of fields: descriptor, encoding, decoding.

Numbers are stored with 64 bits (double, sfixed64). A replay therefore obtains exactly the recorded values,
and all messages of numbers alone have the same length, so that many can be decoded at once with numpy.
The descriptor is stored in the file, so that viewers can plot the fields.
"""

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import cached_property
from operator import index
from typing import Any, Literal, TypeAlias, get_type_hints

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from processing.units import unit_of_name

Kind = Literal["double", "int", "text", "bytes"]
Meanings: TypeAlias = type[IntFlag] | type[IntEnum]

_PACKAGE = "optical_pendulum"
_FIELD = descriptor_pb2.FieldDescriptorProto
PROTO_TYPE: Mapping[Kind, "descriptor_pb2.FieldDescriptorProto.Type.ValueType"] = {
    "double": _FIELD.TYPE_DOUBLE,
    "int": _FIELD.TYPE_SFIXED64,
    "text": _FIELD.TYPE_STRING,
    "bytes": _FIELD.TYPE_BYTES,
}
_FIELD_PATH, _ENUM_PATH = 2, 4
_MEANINGS = {
    "sequence": "number of the frame in the run, from 0; a missing number is a lost frame",
    "time_ns": "ns on the frames' clock, the middle of the exposure; plus epoch_offset_ns of the metadata "
    "'record' (= log time) it is UTC in ns since 1970",
    "turn_time_ns": "ns on the frames' clock; plus epoch_offset_ns of the metadata 'record' it is UTC",
    "device_time_ns": "ns on the camera's own clock; -1 if it has none",
    "host_time_ns": "ns on the computer's monotonic clock",
    "utc_ns": "the computer's clock of the day at host_time_ns, ns since 1970",
    "u_utc_s": "standard uncertainty of utc_ns as the system estimates it, s; NaN if it does not",
    "synchronised": "1 if the system says that its clock of the day follows a time server, else 0",
    "x_px": "position of the spot on the sensor, px; x points right, the centre of the first pixel is 0",
    "y_px": "position of the spot on the sensor, px; y points down, the centre of the first pixel is 0",
    "sigma_x_px": "standard deviation of the light along the principal axis at rotation_rad, px",
    "sigma_y_px": "standard deviation of the light along the other principal axis, px",
    "rotation_rad": "angle of the first principal axis from x towards y, rad",
    "amplitude_dn": "height of the spot above the background, grey values (DN)",
    "background_dn": "background under the spot, grey values (DN)",
    "chi2_per_dof": "residuals of the fit of the spot, 1 if they are the camera's noise alone",
    "x_rad": "tilt of the pendulum along the fast mode's axis (across the swing), rad",
    "y_rad": "tilt of the pendulum along the slow mode's axis (the swing itself), rad",
    "x_arcsec": "x_rad in seconds of arc, for plots",
    "y_arcsec": "y_rad in seconds of arc, for plots: its maxima are the decay",
    "x_deflection_px": "displacement of the spot along the fast mode's axis, px, without a calibrated lever",
    "y_deflection_px": "displacement of the spot along the slow mode's axis, px, without a calibrated lever",
    "index": "number of the half-cycle from the first one, missing ones counted",
    "amplitude_rad": "amplitude of the half-cycle, positive, rad",
    "amplitude_px": "amplitude of the half-cycle, positive, px",
    "amplitude_arcsec": "amplitude_rad in seconds of arc: plotted over time it is the decay",
    "half_period_s": "time since the turning point before, s; NaN for the first and after a missing one",
    "period_s": "twice half_period_s, s",
    "centre_rad": "rest position; the deflection at the turning point is centre + side * amplitude, rad",
    "centre_px": "rest position; the deflection at the turning point is centre + side * amplitude, px",
    "side": "+1 or -1, see Side",
    "flags": "0 if nothing is wrong, else a sum of the values of Flag",
    "temperature_c": "degrees Celsius; NaN if not measured",
    "humidity_percent": "relative humidity, %; NaN if not measured",
    "pressure_pa": "Pa; NaN if not measured",
    "x0_px": "column of the first pixel on the sensor",
    "y0_px": "row of the first pixel on the sensor",
    "pixels": "see 'Pixels of a window' in the attachment record.md",
    "kind": "kind of the event",
    "text": "for the user",
    "author": "who wrote the note; empty if not stated",
}
"""Meanings of the messages' fields; every file states them beside the fields' names."""


def _comment(file: descriptor_pb2.FileDescriptorProto, text: str, *inside: int) -> None:
    """Add a comment on the message, or on the part of it whose path of protobuf's numbers is `inside`."""
    if text:
        first_message = (4, 0)
        file.source_code_info.location.add(
            path=[*first_message, *inside], span=[0, 0, 0], leading_comments=f" {text}\n"
        )


def comment_of(name: str) -> str:
    """Meaning of a field; empty where neither `_MEANINGS` nor the name states one."""
    if name in _MEANINGS:
        return _MEANINGS[name]
    if name.startswith("u_"):
        return f"standard uncertainty (one sigma) of {name[2:]}, in its unit"
    unit = unit_of_name(name)
    return f"in {unit}" if unit else ""


_NUMPY: dict[Kind, str] = {"double": "<f8", "int": "<i8"}
_KIND_OF: dict[object, Kind] = {int: "int", bool: "int", float: "double", str: "text"}
_LAST_SHORT_TAG = 15
"""Largest number of a field whose tag is one byte; the tags of the others here have two."""


@dataclass(frozen=True)
class MessageType:
    """A protobuf message, whose description is stored in every file."""

    name: str
    topic: str
    fields: tuple[tuple[str, Kind], ...]
    """Names and kinds of the fields, whose protobuf numbers count from 1."""
    description: str = dataclasses.field(default="", compare=False)
    meanings: tuple[Meanings, ...] = dataclasses.field(default=(), compare=False)
    """Enumerations that explain the values of fields to people."""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the fields in order."""
        return tuple(name for name, _ in self.fields)

    @property
    def full_name(self) -> str:
        """Name with its protobuf package, by which viewers call the type."""
        return f"{_PACKAGE}.{self.name}"

    @cached_property
    def descriptor(self) -> bytes:
        """Serialised FileDescriptorSet, as it is stored in MCAP files.

        All fields are required, which proto2 alone knows: zeros are then encoded, too. The meanings become
        enumerations inside the message, to be read by people: a field keeps its 64 bits, since several flags
        may be set at once.
        """
        files = descriptor_pb2.FileDescriptorSet()
        file = files.file.add(name=f"{_PACKAGE}/{self.name}.proto", package=_PACKAGE, syntax="proto2")
        message = file.message_type.add(name=self.name)
        _comment(file, self.description)
        for i, (field, kind) in enumerate(self.fields):
            required = _FIELD.LABEL_REQUIRED
            message.field.add(
                name=field, number=i + 1, type=PROTO_TYPE[kind], label=required, json_name=field
            )
            _comment(file, comment_of(field), _FIELD_PATH, i)
        for i, meaning in enumerate(self.meanings):
            enum = message.enum_type.add(name="Flag" if issubclass(meaning, IntFlag) else "Side")
            prefix = enum.name.upper()
            enum.value.add(name=f"{prefix}_NONE", number=0)
            for member in meaning:
                enum.value.add(name=f"{prefix}_{member.name}", number=member.value)
            _comment(file, meaning.__doc__ or "", _ENUM_PATH, i)
        return files.SerializeToString()

    @cached_property
    def _message(self) -> Any:
        """The class that protobuf makes of the descriptor."""
        pool = descriptor_pool.DescriptorPool()
        pool.Add(descriptor_pb2.FileDescriptorSet.FromString(self.descriptor).file[0])
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(self.full_name))

    @cached_property
    def table_dtype(self) -> np.dtype[Any]:
        """Type of the rows of `decode_table`, of a message of numbers alone."""
        return np.dtype([(name, _NUMPY[kind]) for name, kind in self.fields])

    @cached_property
    def wire_dtype(self) -> np.dtype[Any]:
        """Type of an encoded message of numbers alone: each field preceded by its tag."""
        fields: list[Any] = []
        for number, (name, kind) in enumerate(self.fields, start=1):
            tag_bytes = 1 if number <= _LAST_SHORT_TAG else 2
            fields += [(f"tag {name}", f"V{tag_bytes}"), (name, _NUMPY[kind])]
        return np.dtype(fields)

    @cached_property
    def encoded_zeros(self) -> NDArray[Any]:
        """An encoded message of numbers alone, all of them 0, as an array (1,) of `wire_dtype`."""
        return np.frombuffer(self.encode(*[0] * len(self.fields)), self.wire_dtype)

    def encode(self, *values: Any) -> bytes:
        """Encode a message from the values of its fields in order."""
        # protobuf takes no truth value for a whole number
        pairs = zip(self.fields, values, strict=True)
        by_name = {name: index(value) if kind == "int" else value for (name, kind), value in pairs}
        encoded: bytes = self._message(**by_name).SerializeToString()
        return encoded

    def decode(self, data: bytes) -> tuple[Any, ...]:
        """Values of the fields in order. Raises ValueError if the bytes are not such a message."""
        try:
            message = self._message.FromString(data)
        except DecodeError as error:
            raise ValueError(f"{self.full_name}: is not such a message: {error}") from None
        return tuple(getattr(message, name) for name in self.names)

    def decode_table(
        self, messages: bytes | bytearray, names: Collection[str] | None = None, head_bytes: int = 0
    ) -> NDArray[Any]:
        """Joined messages of numbers as a structured array (n,), of all fields or of those in `names`.

        `head_bytes` other bytes precede each message.
        """
        wire = np.frombuffer(messages, [("head", f"V{head_bytes}"), ("message", self.wire_dtype)])["message"]
        fields = [(name, _NUMPY[kind]) for name, kind in self.fields if names is None or name in names]
        table = np.empty(len(wire), dtype=fields)
        for name, _ in fields:
            table[name] = wire[name]
        return table


def message_type_of(value_class: type, topic: str) -> MessageType:
    """Message type, of the class's name, of a NamedTuple whose fields are int, bool, float or str.

    Raises TypeError for other fields.
    """
    hints = get_type_hints(value_class)
    for name, kind in hints.items():
        if kind not in _KIND_OF:
            raise TypeError(f"{value_class.__name__}.{name}: {kind} cannot be recorded")
    fields = tuple((name, _KIND_OF[kind]) for name, kind in hints.items())
    return MessageType(value_class.__name__, topic, fields, " ".join((value_class.__doc__ or "").split()))
