"""How values are spelled in results.json, as annotations that pydantic reads both ways.

null says "not determined": it is read as NaN, and NaN and infinity are written as null.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, JsonValue
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from processing.contact import PendulumOnBall
from processing.estimate import Estimate

JsonObject: TypeAlias = Mapping[str, JsonValue]
"""A JSON object of no fixed keys."""
LARGEST_NUMBER = 1e100
"""No quantity is larger, and the square of a larger one may be none: it is not determined."""


def _null_to_nan(value: object) -> object:
    if isinstance(value, int | float) and abs(value) > LARGEST_NUMBER:
        raise PydanticCustomError("too_large", f"a number up to {LARGEST_NUMBER:.0e}")
    return math.nan if value is None else value


def _nan_to_null(value: float) -> float | None:
    return float(value) if abs(value) <= LARGEST_NUMBER else None


def _possible_pendulum(pendulum: PendulumOnBall) -> PendulumOnBall:
    """Refuse what no pendulum can be, before moments and torques are computed from it."""
    radius_m = pendulum.ball_radius_m
    for name, largest in (
        ("mass_kg", 1e4),
        ("ball_radius_m", 1.0),
        ("contact_radius_m", radius_m),
        ("gravity_m_per_s2", 100.0),
    ):
        if not 0 < getattr(pendulum, name) <= largest:
            raise PydanticCustomError("no_pendulum", f"a pendulum: its {name} lies outside 0 to {largest:g}")
    return pendulum


class _NullForNan:
    """Annotation of a float: null in the file where it is not finite."""

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        written = core_schema.plain_serializer_function_ser_schema(_nan_to_null)
        return core_schema.no_info_before_validator_function(
            _null_to_nan, handler(source), serialization=written
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"type": ["number", "null"]}


class _NamedObject:
    """Annotation of a NamedTuple: an object with its names as keys, not an array."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        kinds = {name: Number if kind is float else kind for name, kind in source.__annotations__.items()}
        shape = core_schema.typed_dict_schema(
            {
                name: core_schema.typed_dict_field(
                    handler.generate_schema(kind), required=name not in source._field_defaults
                )
                for name, kind in kinds.items()
            }
        )
        return core_schema.no_info_after_validator_function(
            lambda found: source(**found),
            shape,
            serialization=core_schema.plain_serializer_function_ser_schema(_named_object),
        )


def _named_object(value: Any) -> dict[str, Any]:
    return {
        name: _nan_to_null(item) if isinstance(item, float) else item
        for name, item in value._asdict().items()
    }


class _Array:
    """Annotation of a one-dimensional array: a list of numbers."""

    def __init__(self, kind: type[float] | type[int]) -> None:
        self._kind = kind

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        items = handler(tuple[Number, ...] if self._kind is float else tuple[int, ...])
        dtype = np.float64 if self._kind is float else np.int64
        return core_schema.no_info_after_validator_function(
            lambda found: np.array(found, dtype=dtype),
            items,
            serialization=core_schema.plain_serializer_function_ser_schema(_listed),
        )


def _listed(values: NDArray[Any]) -> list[Any]:
    return [item if isinstance(item, int) else _nan_to_null(item) for item in values.tolist()]


@dataclass(frozen=True)
class Beside:
    """Annotation of a dataclass: the entries of its mapping `field` stand beside its own keys in the file.

    The field is marked by `Entries`. So ``fits.exact`` holds ``b``, ``p``, ... next to ``chi2_per_dof``.
    Objects under keys that the dataclass does not have are taken for entries; other unknown keys are ignored.
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


def with_entries_beside(schema: dict[str, Any]) -> dict[str, Any]:
    """A JSON schema in which marked mappings have become what else their object may hold.

    Titles that only repeat a key are left out.
    """
    for shape in schema["$defs"].values():
        for name, item in list(shape.get("properties", {}).items()):
            item.pop("title", None)
            if item.pop("x-entries", False):
                shape["additionalProperties"] = shape["properties"].pop(name)["additionalProperties"]
    return schema


class _Section:
    """Annotation of a part or None: None is an empty object in the file."""

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        inner = handler(source)
        return core_schema.no_info_before_validator_function(
            lambda value: None if value == {} else value,
            inner,
            serialization=core_schema.wrap_serializer_function_ser_schema(
                lambda value, serialised: {} if value is None else serialised(value), schema=inner
            ),
        )


Number = Annotated[float, _NullForNan()]
"""A float; NaN, which is null in the file, where it is not determined."""
Value = Annotated[Estimate, _NamedObject()]
"""A value with its standard uncertainty, an object with these two keys."""
AsObject = _NamedObject()
Pendulum = Annotated[PendulumOnBall, AfterValidator(_possible_pendulum)]
Floats = Annotated[NDArray[np.float64], _Array(float)]
Integers = Annotated[NDArray[np.int64], _Array(int)]
Section = _Section()
"""Of a part that need not be there (None): an empty object in the file, so that its key is always there."""
LeftOut = Field(exclude_if=lambda value: value is None)
"""Of a part whose key is not in the file where there is none."""
Entries = Field(json_schema_extra={"x-entries": True})
"""Marks the mapping whose entries stand `Beside` the keys of its dataclass, for the JSON schema."""
