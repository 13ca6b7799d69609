"""Encoding of values in results.json: that of pydantic for plain dataclasses, with some annotations.

null says "not determined": it is read as NaN, and NaN and infinity are written as null.
"""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, TypeAlias, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, GetCoreSchemaHandler, GetPydanticSchema, JsonValue, TypeAdapter
from pydantic_core import CoreSchema, SchemaSerializer, SchemaValidator, core_schema

from processing.quantity import quantities_of

JsonObject: TypeAlias = Mapping[str, JsonValue]
"""A JSON object of no fixed keys."""
_MAX_NUMBER = 1e100
"""Largest number of a file; a larger one is written as null, "not determined"."""


@functools.cache
def codec(kind: Any) -> tuple[SchemaValidator, SchemaSerializer]:
    """Decoder and encoder of the values of one type, such as a frozen dataclass.

    A float is a number in the file, or null where it is not determined. A field that is None by default is
    left out where it is None.
    """
    schema = _with_nulls(TypeAdapter(kind).core_schema)
    return SchemaValidator(schema), SchemaSerializer(schema)


def _with_nulls(schema: Any) -> Any:
    """The same schema, in which NaN is null in the file, and fields that are None are left out."""
    if isinstance(schema, list | tuple):
        return type(schema)(map(_with_nulls, schema))
    if not isinstance(schema, dict):
        return schema
    if schema.get("type") == "float":
        serializer = core_schema.plain_serializer_function_ser_schema(
            lambda value: float(value) if abs(value) <= _MAX_NUMBER else None
        )
        return core_schema.no_info_before_validator_function(
            lambda value: math.nan if value is None else value, schema, serialization=serializer
        )
    changed = {key: _with_nulls(value) for key, value in schema.items()}
    if schema.get("type") == "dataclass-field" and schema["schema"].get("default", "") is None:
        changed["serialization_exclude_if"] = lambda value: value is None
    return changed


def _array_of(items: Any, dtype: Any) -> GetPydanticSchema:
    """Annotation of a one-dimensional array: a list of numbers."""

    def as_list(values: NDArray[Any]) -> list[Any]:
        return [number if abs(number) <= _MAX_NUMBER else None for number in values.tolist()]

    return GetPydanticSchema(
        lambda source, handler: core_schema.no_info_after_validator_function(
            lambda numbers: np.array(numbers, dtype=dtype),
            handler(items),
            serialization=core_schema.plain_serializer_function_ser_schema(as_list),
        )
    )


@dataclass(frozen=True)
class MergedField:
    """Annotation of a dataclass: in the file, the entries of its mapping `field` are among its own keys.

    The mapping is marked by `Entries`. So ``fits.exact`` holds ``b``, ``p``, ... next to ``chi2_per_dof``.
    Objects under keys that the dataclass does not have are read as entries; other unknown keys are ignored.
    """

    field: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        own = {item.name for item in fields(source)} - {self.field}

        def gather(value: object) -> object:
            if not isinstance(value, Mapping):
                return value
            entries = {k: v for k, v in value.items() if k not in own and isinstance(v, Mapping)}
            return {**{k: v for k, v in value.items() if k in own}, self.field: entries}

        def spread(value: object, serialise: Callable[[object], dict[str, Any]]) -> dict[str, Any]:
            tree = serialise(value)
            return {**tree.pop(self.field), **tree}

        inner = handler(source)
        serializer = core_schema.wrap_serializer_function_ser_schema(spread, schema=inner)
        return core_schema.no_info_before_validator_function(gather, inner, serialization=serializer)


def file_schema(kind: Any) -> dict[str, Any]:
    """JSON schema of the values of a dataclass in their file: a number may be null, a quantity has its unit.

    A key has the sentence under its field as description. Mappings marked by `Entries` become the additional
    properties of their object; titles that only repeat a key are left out.
    """
    # of a list, because the adapter of a dataclass takes no configuration
    adapter = TypeAdapter[Any](list[kind], config=ConfigDict(use_attribute_docstrings=True))
    schema: dict[str, Any] = adapter.json_schema()
    _allow_null(schema)
    kinds = {item.__name__: item for item in _dataclasses(kind, set())}
    for title, shape in schema["$defs"].items():
        declared = quantities_of(kinds[title]) if title in kinds else {}
        for name, item in list(shape.get("properties", {}).items()):
            item.pop("title", None)
            if name in declared and declared[name].meaning:
                item.setdefault("description", declared[name].meaning)
                item["unit"] = declared[name].unit
            if item.pop("x-entries", False):
                shape["additionalProperties"] = shape["properties"].pop(name)["additionalProperties"]
    root = schema["$defs"].pop(kind.__name__)
    return {"$defs": schema["$defs"], **root}


def _dataclasses(kind: Any, kinds: set[type]) -> set[type]:
    """All dataclasses that a type contains, itself included; added to `kinds`."""
    if isinstance(kind, type) and is_dataclass(kind) and kind not in kinds:
        kinds.add(kind)
        for hint in get_type_hints(kind).values():
            _dataclasses(hint, kinds)
    for part in get_args(kind):
        _dataclasses(part, kinds)
    return kinds


def _allow_null(schema: Any) -> None:
    if isinstance(schema, list):
        for item in schema:
            _allow_null(item)
    elif isinstance(schema, dict):
        if schema.get("type") == "number":
            schema["type"] = ["number", "null"]
        for item in schema.values():
            _allow_null(item)


Floats = Annotated[NDArray[np.float64], _array_of(tuple[float, ...], np.float64)]
Integers = Annotated[NDArray[np.int64], _array_of(tuple[int, ...], np.int64)]
Entries = Field(json_schema_extra={"x-entries": True})
"""Marks, for the JSON schema, the mapping of a `MergedField`."""
