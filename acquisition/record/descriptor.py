"""Protobuf's description of a flat message, with comments and the meaning of its flags, for any reader."""

from collections.abc import Iterable, Mapping
from enum import IntEnum, IntFlag
from typing import Literal, TypeAlias

from google.protobuf import descriptor_pb2

from processing.units import unit_of_name

Kind = Literal["double", "int", "text", "bytes"]
Meanings: TypeAlias = type[IntFlag] | type[IntEnum]

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
    "author": "who has noted it; empty if nobody said",
}
"""What the fields of the messages mean, as it stands in every file beside their names."""


def descriptor_of(
    full_name: str, fields: Iterable[tuple[str, Kind]], about: str, meanings: Iterable[Meanings]
) -> bytes:
    """Serialised FileDescriptorSet, as it is stored in MCAP files.

    `about` says what a message is. `meanings` become enumerations inside the message: a field keeps its 64
    bits, since several flags may be set at once.
    """
    package, _, name = full_name.rpartition(".")
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name=f"{package}/{name}.proto", package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    _comment(file, about)
    for place, (field, kind) in enumerate(fields):
        message.field.add(
            name=field,
            number=place + 1,
            type=PROTO_TYPE[kind],
            label=_FIELD.LABEL_OPTIONAL,
            json_name=field,
        )
        _comment(file, comment_of(field), _FIELD_PATH, place)
    for place, meaning in enumerate(meanings):
        enum = message.enum_type.add(name=meaning.__name__.removeprefix("Spot").removeprefix("Swing"))
        prefix = enum.name.upper()
        enum.value.add(name=f"{prefix}_NONE", number=0)
        for member in meaning:
            enum.value.add(name=f"{prefix}_{member.name}", number=member.value)
        _comment(file, meaning.__doc__ or "", _ENUM_PATH, place)
    return files.SerializeToString()


def _comment(file: descriptor_pb2.FileDescriptorProto, text: str, *inside: int) -> None:
    """Comment on the message, or on what is inside it by protobuf's numbers."""
    if text:
        first_message = (4, 0)
        file.source_code_info.location.add(
            path=[*first_message, *inside], span=[0, 0, 0], leading_comments=f" {text}\n"
        )


def comment_of(name: str) -> str:
    """What a field means; empty where its name says nothing."""
    if name in _MEANINGS:
        return _MEANINGS[name]
    if name.startswith("u_"):
        return f"standard uncertainty (one sigma) of {name[2:]}, in its unit"
    unit = unit_of_name(name)
    return f"in {unit}" if unit else ""
