"""Protobuf's description of a flat message, with comments and the meaning of its flags, for any reader."""

from collections.abc import Iterable, Mapping
from enum import IntEnum, IntFlag
from typing import Literal, TypeAlias

from google.protobuf import descriptor_pb2

from acquisition.record.field_comments import comment_of

Kind = Literal["double", "int", "text", "bytes"]
Meanings: TypeAlias = type[IntFlag] | type[IntEnum]

_FIELD = descriptor_pb2.FieldDescriptorProto
PROTO_TYPE: Mapping[Kind, "descriptor_pb2.FieldDescriptorProto.Type.ValueType"] = {
    "double": _FIELD.TYPE_DOUBLE,
    "int": _FIELD.TYPE_SFIXED64,
    "text": _FIELD.TYPE_STRING,
    "bytes": _FIELD.TYPE_BYTES,
}
_FIELD_PATH, _ENUM_PATH, _VALUE_PATH = 2, 4, 2


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
