"""Faults of a configuration in words, and the sections and keys of its models."""

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any, NamedTuple, TypeVar, cast, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.dataclasses import dataclass, is_pydantic_dataclass
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from processing.errors import ConfigurationError, KeyPath, key_path_text
from processing.fault_text import fault_text, is_unknown_key
from processing.units import unit_of_name
from rig.settings.number_input import read_quantity, states_unit

_Model = TypeVar("_Model", bound=BaseModel)

_SYNONYMS = {"fps": "frame_rate_hz"}
"""Keys by the words that users write instead and that are spelled quite differently."""


def fault_line(root: type, fault: ErrorDetails) -> str:
    """One line for a fault that pydantic found in the tables of `root`."""
    path = key_path_text(fault["loc"])
    if is_unknown_key(fault):
        section = str(fault["loc"][-1])
        if isinstance(fault["input"], Mapping) and section in section_fields(root):
            # the user wrote a dotted key, as for --set, below the head of its section
            key = next(iter(fault["input"]), "")
            return f"{path}.{key}: unknown key; below [{section}] it is {key}, without '{section}.'"
        dotted_keys = _dotted_keys(root) if len(fault["loc"]) == 1 else {}
        if section in dotted_keys:
            return f"{path}: unknown key; did you mean {' or '.join(dotted_keys[section])}?"
        known = list(section_fields(_section_at(root, fault["loc"][:-1])))
        synonym = _SYNONYMS.get(section)
        close = [synonym] if synonym in known else difflib.get_close_matches(section, known, n=1, cutoff=0.51)
        if not close:
            similar = difflib.get_close_matches(section, dotted_keys, n=1, cutoff=0.7)
            close = [dotted_keys[name][-1] for name in similar]
        hint = f"did you mean {close[0]}?" if close else f"known here: {', '.join(sorted(known))}"
        return f"{path}: unknown key; {hint}"
    if fault["type"] == "missing":
        field = section_fields(_section_at(root, fault["loc"][:-1])).get(str(fault["loc"][-1]))
        description = f": {field.description}" if field is not None and field.description else ""
        return f"{path}: is missing; state a value{description}"
    if isinstance(fault["input"], str) and re.fullmatch(r"[+-]?\d+,\d+", fault["input"]):
        corrected = fault["input"].replace(",", ".")
        return f"{path} = {fault['input']!r}: should be a number, with a point: {corrected}"
    if fault["type"] == "float_parsing" and states_unit(fault["input"]):
        return f"{path} = {fault['input']!r}: {_expected_number(fault['input'], str(fault['loc'][-1]))}"
    return fault_text(fault)


def _expected_number(text: str, key: str) -> str:
    """Expected text of a number that was stated with its unit, which is part of the key."""
    unit = unit_of_name(key)
    expected = f"should be a number alone, in {unit}" if unit else "should be a number alone"
    try:
        value, _ = read_quantity(text, unit)
    except ConfigurationError:
        # the stated unit does not fit
        return expected
    return f"{expected}: {value:g}"


class KeyFault(NamedTuple):
    """A fault of the key at a place, or between several keys if the place is empty."""

    place: KeyPath
    line: str
    is_missing: bool = False


def validate(root: type[_Model], tree: Mapping[str, Any]) -> tuple[_Model | None, list[KeyFault]]:
    """The model of nested tables; or None and its faults, unknown keys first."""
    wrong_numbers = list(number_faults(root, tree))
    places = {fault.place for fault in wrong_numbers}
    try:
        model = root.model_validate(tree)
    except ValidationError as error:
        faults = sorted(error.errors(), key=lambda fault: not is_unknown_key(fault))
        # leave out faults of a list that follow from a fault of an entry
        containers = {fault["loc"][:depth] for fault in faults for depth in range(len(fault["loc"]))} - {()}
        superseded = places | containers
        key_faults = [
            KeyFault(fault["loc"], fault_line(root, fault), fault["type"] == "missing")
            for fault in faults
            if fault["loc"] not in superseded
        ]
        return None, key_faults + wrong_numbers
    return (None, wrong_numbers) if wrong_numbers else (model, [])


def number_faults(root: type, tree: Mapping[str, Any], place: KeyPath = ()) -> Iterator[KeyFault]:
    """Faults of keys with `true` or `"3"`, which pydantic would take for a number, or with `inf` or `nan`."""
    for key, value in tree.items():
        field = section_fields(root).get(key)
        if field is None:
            continue
        section, path = section_of(field), (*place, key)
        if section is not None and isinstance(value, dict):
            tables = value if get_origin(field.annotation) is dict else {None: value}
            for name, table in tables.items():
                if isinstance(table, dict):
                    yield from number_faults(section, table, path if name is None else (*path, name))
        elif isinstance(value, bool | str) and _is_number(field, value):
            is_bool = isinstance(value, bool)
            text, hint = (str(value).lower(), "") if is_bool else (f'"{value}"', ", without quotes")
            yield KeyFault(path, f"{key_path_text(path)} = {text}: should be a number{hint}")
        elif isinstance(value, float) and not math.isfinite(value) and not key.endswith("_dof"):
            yield KeyFault(path, f"{key_path_text(path)} = {value}: should be a finite number")


def _is_number(field: FieldInfo, value: bool | str) -> bool:
    """Whether a field takes only numbers; a string that is no number is left to pydantic."""
    types = set(_types_in(field.annotation))
    if not types & {int, float} or types & {bool, str}:
        return False
    if isinstance(value, bool):
        return True
    try:
        float(value)
    except ValueError:
        return False
    return True


def section_fields(section: type) -> dict[str, FieldInfo]:
    """Fields of a section, which is a pydantic model or a plain dataclass of `processing`."""
    if issubclass(section, BaseModel):
        return section.model_fields
    if not is_pydantic_dataclass(section):
        section = dataclass(section, frozen=True)
    return cast(dict[str, FieldInfo], vars(section)["__pydantic_fields__"])


def section_of(field: FieldInfo) -> type | None:
    """The section class of a field that holds a section or a table of sections; None for a plain value."""
    classes = (c for c in _types_in(field.annotation) if isinstance(c, type) and get_origin(c) is None)
    return next((c for c in classes if issubclass(c, BaseModel) or is_dataclass(c)), None)


def _types_in(annotation: Any) -> Iterator[Any]:
    """An annotation and all types that it contains."""
    yield annotation
    for inner in get_args(annotation):
        yield from _types_in(inner)


def _section_at(root: type, place: KeyPath) -> type:
    """The section at a place; a name of the user's own stands for the section that it names."""
    for name in place:
        field = section_fields(root).get(str(name))
        section = None if field is None else section_of(field)
        if section is None:
            break
        root = section
    return root


def _dotted_keys(root: type) -> dict[str, list[str]]:
    """The dotted keys of all sections by their last name."""
    keys: dict[str, list[str]] = {}
    for name, field in section_fields(root).items():
        section = section_of(field)
        for key in () if section is None else section_fields(section):
            keys.setdefault(key, []).append(f"{name}.{key}")
    return keys
