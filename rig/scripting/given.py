"""What scripts hand over, as this program takes it; anything else is refused in a line."""

import json
import os
from collections.abc import Iterable, Mapping
from numbers import Integral
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError

_SAVED = "save what is in memory first (to_csv, numpy.save) and name the file"


def path_of(value: object, what: str) -> Path:
    """A path. Raises ConfigurationError for an array or a data frame in its place."""
    if isinstance(value, str | os.PathLike):
        return Path(value)
    raise ConfigurationError(f"{what}: a path is needed, not {_named(value)}; {_SAVED}")


def text_of(value: object, what: str, such_as: str) -> str:
    """A text, empty for None. Raises ConfigurationError for anything else."""
    if value is None or isinstance(value, str):
        return value or ""
    raise ConfigurationError(f"{what}: a text such as {such_as!r} is needed, not {_named(value)}")


def columns_of(value: Any, what: str) -> tuple[str, ...]:
    """Columns by name or number, one or several; raises ConfigurationError for what is neither."""
    found = list(value) if isinstance(value, Iterable) and not isinstance(value, str) else [value]
    if wrong := [one for one in found if isinstance(one, bool) or not isinstance(one, str | Integral)]:
        raise ConfigurationError(
            f"{what}: names of columns, or numbers from 1, are needed, not {_named(wrong[0])}"
        )
    return tuple(map(str, found))


def several(value: Any, single: tuple[type, ...], what: str) -> list[Any]:
    """One, or a sequence of them, as a list; raises ConfigurationError for none, and for what is neither."""
    if isinstance(value, (str, os.PathLike, *single)):
        return [value]
    # an array or a data frame would be gone through by its numbers or columns
    if not isinstance(value, Iterable) or hasattr(value, "shape"):
        raise ConfigurationError(f"{what}: paths, or what was opened, are needed, not {_named(value)}")
    found = list(value)
    if not found:
        raise ConfigurationError(f"{what}: is empty; name at least one")
    return found


def overrides_of(changes: Mapping[str, object] | None) -> list[str]:
    """``KEY=VALUE`` as on the command line; numbers of NumPy are numbers."""
    if changes is None:
        return []
    if not isinstance(changes, Mapping):
        raise ConfigurationError(
            'overrides: a mapping from keys to values is needed, {"fit.robust": True}, '
            f"not {_named(changes)}"
        )
    return [f"{_key(key)}={_written(str(key), value)}" for key, value in changes.items()]


def _key(key: object) -> str:
    text = str(key)
    if "=" in text or not text.isprintable():
        raise ConfigurationError(f"overrides: {text!r} is no key of the configuration")
    return text


def _written(key: str, value: object) -> str:
    plain = value.item() if hasattr(value, "item") and not hasattr(value, "__len__") else value
    try:
        return json.dumps(plain)
    except TypeError:
        raise ConfigurationError(
            f"overrides: {key}: {_named(value)} is no value of a configuration; a number, a text, true or "
            "false"
        ) from None


def _named(value: object) -> str:
    return "None" if value is None else f"a {type(value).__name__}"
