"""Errors that are reported to the user, and the texts of their messages.

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
    """A Python package of an optional part of the program, such as a kind of camera, cannot be imported."""


def optional_module(module: str, purpose: str, package: str, extra: str, alternative: str = "") -> Any:
    """The module `module` of a package; raises MissingPackage where that is not installed, or is broken.

    `purpose` needs the package, `extra` is the extra of pyproject.toml that installs it, `alternative` does
    without it.
    """
    root = module.partition(".")[0]
    try:
        import_module(root)
        return import_module(module)
    except Exception as error:
        why, option = f"of the extra {extra}", ""
        if not isinstance(error, ModuleNotFoundError) or error.name != root:
            why = f"which is installed but cannot be loaded ({one_line_text(error)})"
            option = "--force-reinstall "
        text = f"{purpose} needs {package}, {why}: {sys.executable} -m pip install {option}{package}"
        raise MissingPackage(f"{text}, or {alternative}" if alternative else text) from None


class RecordError(RigError):
    """A record cannot be written, or a file is not a valid record."""


class DataError(RigError):
    """The data do not suffice for the analysis requested (too few half-cycles, no spot, no decay)."""


def require_schema(file: str, schema: object, supported: int, kind: type[RigError]) -> None:
    """Raise an error of this `kind` for a file whose schema is not the one that this version reads."""
    if schema != supported or isinstance(schema, bool):
        raise kind(f"{file}: is of schema {schema!r}; this version reads schema {supported}")


KeyPath = tuple[int | str, ...]
"""Keys, and positions in lists from 0, from the top of a file to a value in it."""


def dotted_key(path: KeyPath) -> str:
    """The path of a key as `--set` takes it."""
    return ".".join(part if isinstance(part, str) and part.isprintable() else repr(part) for part in path)


def key_path_text(path: KeyPath) -> str:
    """The path of a key as a person reads it: entries of a list count from 1, ``level 1: frames``."""
    text = ""
    for depth, part in enumerate(path):
        if isinstance(part, int):
            text += f" {part + 1}"
        elif depth:
            text += f"{': ' if isinstance(path[depth - 1], int) else '.'}{dotted_key((part,))}"
        else:
            text = dotted_key((part,))
    return text


def one_line_text(error: Exception) -> str:
    """Text of an error in one line, after the name of its class unless it is a `RigError`."""
    text = re.sub(r"\s+", " ", f"{error}").strip()
    if isinstance(error, RigError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
