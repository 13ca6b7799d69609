"""What a command found, as the one JSON object that its option ``--json`` prints."""

import contextlib
import dataclasses
import datetime
import json
import sys
from collections.abc import Iterator
from contextvars import ContextVar
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from rig.presentation.printing import Table, plain_values

_FOUND: ContextVar[dict[str, Any] | None] = ContextVar("found", default=None)


def answer(**found: object) -> None:
    """Say beside what is printed for a person what a program is to read; without ``--json`` nothing happens.

    A list that is stated again is continued: records, files, tables.
    """
    told = _FOUND.get()
    if told is None:
        return
    for name, value in found.items():
        if isinstance(value, list) and name in told:
            told[name] += value
        else:
            told[name] = value


@contextlib.contextmanager
def one_json_object() -> Iterator[None]:
    """What is printed within it goes to stderr, and at its end one JSON object to stdout.

    After an error there is none: its line on stderr and the exit status say it.
    """
    found: dict[str, Any] = {}
    before = _FOUND.set(found)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        _FOUND.reset(before)
    print(json.dumps(plain_values(_plain(found)), ensure_ascii=False), flush=True)


def _plain(value: Any) -> Any:
    """Nested values as JSON has them."""
    if isinstance(value, Table):
        rows = [_plain(list(row)) for row in value.rows]
        return {"name": value.name, "title": value.title, "columns": list(value.columns), "rows": rows}
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {item.name: _plain(getattr(value, item.name)) for item in dataclasses.fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, datetime.datetime | datetime.date):
        return value.isoformat()
    return str(value) if isinstance(value, Path) else value
