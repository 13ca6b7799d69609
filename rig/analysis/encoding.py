"""Encoding of values in results.json: that of pydantic for plain dataclasses, with some annotations.

null says "not determined": it is read as NaN, and NaN and infinity are written as null.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, TypeAlias, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, GetCoreSchemaHandler, JsonValue, TypeAdapter
from pydantic_core import CoreSchema, SchemaSerializer, SchemaValidator, core_schema

from processing.quantity import quantities_of

JsonObject: TypeAlias = Mapping[str, JsonValue]
"""A JSON object of no fixed keys."""
LARGEST_NUMBER = 1e100
"""Largest number of a file; a larger one is not determined, and null."""


def _nan_to_null(value: float) -> float | None:
    return float(value) if abs(value) <= LARGEST_NUMBER else None


class Codec:
    """Encoder and decoder of values of one type; a frozen dataclass of any room needs no annotation for it.

    A float is a number in the file, or null where it is not determined. An optional part that is None is left
    out.
    """

    def __init__(self, kind: Any) -> None:
        schema = _as_stored(TypeAdapter(kind).core_schema)
        self._validator, self._serializer = SchemaValidator(schema), SchemaSerializer(schema)

    def read(self, tree: object) -> Any:
        """The value of a JSON tree; raises pydantic's ValidationError."""
        return self._validator.validate_python(tree)

    def write(self, value: object) -> Any:
        """The JSON tree of a value."""
        return self._serializer.to_python(value, mode="json")


def _as_stored(schema: Any) -> Any:
    """The same schema, where every float is null for NaN, and None is left out."""
    if isinstance(schema, list | tuple):
        return type(schema)(map(_as_stored, schema))
    if not isinstance(schema, dict):
        return schema
    if schema.get("type") == "float":
        written = core_schema.plain_serializer_function_ser_schema(_nan_to_null)
        return core_schema.no_info_before_validator_function(
            lambda value: math.nan if value is None else value, schema, serialization=written
        )
    found = {key: _as_stored(value) for key, value in schema.items()}
    if schema.get("type") == "dataclass-field" and schema["schema"].get("default", "") is None:
        found["serialization_exclude_if"] = lambda value: value is None
    return found


class _Array:
    """Annotation of a one-dimensional array: a list of numbers."""

    def __init__(self, kind: type[float] | type[int]) -> None:
        self._kind = kind

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        items = handler(tuple[self._kind, ...])  # type: ignore[name-defined]
        dtype = np.float64 if self._kind is float else np.int64
        return core_schema.no_info_after_validator_function(
            lambda found: np.array(found, dtype=dtype),
            items,
            serialization=core_schema.plain_serializer_function_ser_schema(_as_list),
        )


def _as_list(values: NDArray[Any]) -> list[Any]:
    listed: list[Any] = values.tolist()
    for undetermined in np.flatnonzero(~(np.abs(values) <= LARGEST_NUMBER)).tolist():
        listed[undetermined] = None
    return listed


@dataclass(frozen=True)
class MergedField:
    """Annotation of a dataclass: the entries of its mapping `field` are among its own keys in the file.

    The field is marked by `Entries`. So ``fits.exact`` holds ``b``, ``p``, ... next to ``chi2_per_dof``.
    Objects under keys that the dataclass does not have are read as entries; other unknown keys are ignored.
    """

    field: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        own = {item.name for item in fields(source)} - {self.field}

        def gathered(value: object) -> object:
            if not isinstance(value, Mapping):
                return value
            entries = {k: v for k, v in value.items() if k not in own and isinstance(v, Mapping)}
            return {**{k: v for k, v in value.items() if k in own}, self.field: entries}

        def spread(value: object, serialised: Callable[[object], dict[str, Any]]) -> dict[str, Any]:
            tree = serialised(value)
            return {**tree.pop(self.field), **tree}

        inner = handler(source)
        return core_schema.no_info_before_validator_function(
            gathered,
            inner,
            serialization=core_schema.wrap_serializer_function_ser_schema(spread, schema=inner),
        )


def file_schema(kind: Any) -> dict[str, Any]:
    """JSON schema of the values of a type in their file: a number may be null, and declared ones have a unit.

    Mappings marked by `Entries` become the additional properties of their object; titles that only repeat a
    key are left out.
    """
    schema: dict[str, Any] = TypeAdapter[Any](kind).json_schema()
    _allow_null(schema)
    kinds = {found.__name__: found for found in _dataclasses(kind, set())}
    for title, shape in schema["$defs"].items():
        declared = quantities_of(kinds[title]) if title in kinds else {}
        for name, item in list(shape.get("properties", {}).items()):
            item.pop("title", None)
            if name in declared and declared[name].meaning:
                item |= {"description": declared[name].meaning, "unit": declared[name].unit}
            if item.pop("x-entries", False):
                shape["additionalProperties"] = shape["properties"].pop(name)["additionalProperties"]
    return schema


def _dataclasses(kind: Any, found: set[type]) -> set[type]:
    """All dataclasses that a type contains, itself included; added to `found`."""
    if isinstance(kind, type) and is_dataclass(kind) and kind not in found:
        found.add(kind)
        for hint in get_type_hints(kind).values():
            _dataclasses(hint, found)
    for part in get_args(kind):
        _dataclasses(part, found)
    return found


def _allow_null(schema: Any) -> None:
    if isinstance(schema, list):
        for item in schema:
            _allow_null(item)
    elif isinstance(schema, dict):
        if schema.get("type") == "number":
            schema["type"] = ["number", "null"]
        for item in schema.values():
            _allow_null(item)


Floats = Annotated[NDArray[np.float64], _Array(float)]
Integers = Annotated[NDArray[np.int64], _Array(int)]
Entries = Field(json_schema_extra={"x-entries": True})
"""Marks, for the JSON schema, the mapping of a `MergedField`."""
