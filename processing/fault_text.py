"""Faults that pydantic reports of the tables of a file, as text."""

import datetime
from collections.abc import Mapping
from typing import Any, Final

from processing.errors import key_path_text
from processing.units import unit_of_name

Fault = Mapping[str, Any]
"""A fault as pydantic lists it: `type`, `loc`, `msg`, `input` and `ctx`."""
_MAX_LENGTH: Final = 80
_EXPECTED: Final = {
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "path": "the name of a file, in quotes",
    "string": "text, in quotes",
    **dict.fromkeys(("dataclass", "dict", "is", "model"), "a table with keys of its own"),
    **dict.fromkeys(("list", "tuple"), "a list in brackets"),
    **dict.fromkeys(
        ("datetime", "timezone"), "a time with its offset from UTC, such as 2026-11-22T09:30:00+01:00"
    ),
}
"""The kind of value by the first word of pydantic's type of a fault."""


def fault_text(fault: Fault) -> str:
    """A fault in one line: the key, its value and what it should be; the message alone without a key."""
    key, message = key_path_text(fault["loc"]), str(fault["msg"]).removeprefix("Value error, ")
    if is_unknown_key(fault):
        return f"{key}: unknown key"
    if fault["type"] in ("missing", "missing_argument"):
        return f"{key}: is missing; state a value"
    if not key:
        return message
    if not fault["type"].startswith("value_error"):
        message = f"should be {expected_text(fault)}"
    elif isinstance(fault["input"], Mapping):
        # the fault is of a whole section, whose message names keys and values itself
        return f"{key}: {message.removeprefix(f'{key}: ')}"
    return f"{key} = {value_text(fault['input'])}: {message}"


def is_unknown_key(fault: Fault) -> bool:
    """Whether a fault is that of an unknown key."""
    return fault["type"] in ("extra_forbidden", "unexpected_keyword_argument")


def expected_text(fault: Fault) -> str:
    """The expected kind of value, in words, for a value of the wrong type or out of range."""
    kind = fault["type"]
    if kind == "string_pattern_mismatch":
        return f"text like {fault['ctx']['pattern']}"
    if expected := _EXPECTED.get(kind.partition("_")[0]):
        return expected
    if kind in ("too_short", "too_long"):
        low, high = (fault["ctx"].get(name) for name in ("min_length", "max_length"))
        return f"a list of {f'{low} entries or more' if high is None else f'at most {high} entries'}"
    text = str(fault["msg"]).removeprefix("Input should be ").partition(", unable to")[0]
    if kind.startswith(("greater_than", "less_than")):
        text = text.replace("greater than or equal to", "at least").replace(
            "less than or equal to", "at most"
        )
        unit = unit_of_name(str(fault["loc"][-1]) if fault["loc"] else "")
        text += f" {unit.replace('^2', '²')}" if unit else ""
    return text


def value_text(value: Any) -> str:
    """A value as a message shows it; a long one is cut."""
    text = value.isoformat() if isinstance(value, datetime.datetime) else repr(value)
    return text if len(text) <= _MAX_LENGTH else f"{text[: _MAX_LENGTH - 3]}..."
