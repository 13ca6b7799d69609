"""Errors that are reported to the user.

A message names the item, the value received and what to do. Modules raise the most specific class; the
command line prints any `RigError` as one line and sets the exit status.
"""

import re
import sys
from importlib import import_module
from typing import Any


class RigError(Exception):
    """Base class of all errors that are reported to the user."""


class ConfigurationError(RigError):
    """A request cannot be carried out as it is stated (exit status 2; any other error: 1).

    A setting is unknown, missing, of the wrong unit or out of range; a file is missing, or exists already.
    """


class DeviceError(RigError):
    """A camera, controller, laser or sensor is missing, rejects a command or was disconnected."""


class MissingPackage(ConfigurationError, DeviceError):
    """A Python package of an optional part of the program, such as a kind of camera, is not installed.

    `extra` is the extra of pyproject.toml that installs it, `instead` an alternative without the package.
    """

    def __init__(self, what: str, package: str, extra: str, instead: str = "") -> None:
        brought = f"{what} needs {package}, of the extra {extra}: {sys.executable} -m pip install {package}"
        super().__init__(f"{brought}, or {instead}" if instead else brought)


def optional_module(module: str, what: str, package: str, extra: str, instead: str = "") -> Any:
    """A module of an optional package; raises MissingPackage, with the other arguments, without it."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingPackage(what, package, extra, instead) from None


class RecordError(RigError):
    """A record cannot be written, or a file is not a valid record."""


class DataError(RigError):
    """The data do not suffice for the analysis requested (too few swings, no spot, no decay)."""


def require_schema(what: str, stated: object, read: int, kind: type[RigError]) -> None:
    """Raise `kind` for a file, `what`, whose `stated` schema is not the one that this version reads."""
    if stated != read or isinstance(stated, bool):
        raise kind(f"{what}: is of schema {stated!r}; this version reads schema {read}")


KeyPlace = tuple[int | str, ...]
"""Keys, and positions in lists from 0, from the top of a file to a value in it."""


def dotted(place: KeyPlace) -> str:
    """The path of a key as `--set` takes it."""
    return ".".join(part if isinstance(part, str) and part.isprintable() else repr(part) for part in place)


def place_in_words(place: KeyPlace) -> str:
    """The path of a key as a person reads it: entries of a list count from 1, ``level 1: frames``."""
    text = ""
    for depth, part in enumerate(place):
        if isinstance(part, int):
            text += f" {part + 1}"
        elif depth:
            text += f"{': ' if isinstance(place[depth - 1], int) else '.'}{dotted((part,))}"
        else:
            text = dotted((part,))
    return text


def in_one_line(error: Exception) -> str:
    """Text of an error in one line, after the name of its class unless it is a `RigError`."""
    text = re.sub(r"\s+", " ", f"{error}").strip()
    if isinstance(error, RigError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
