"""Reads a TOML file; what is wrong with it is said in one line."""

import re
import tomllib
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError

_TWICE = ("Cannot overwrite a value", "Cannot declare", "Duplicate")


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The tables of a file that is called `what`; it may begin with a byte order mark.

    Raises ConfigurationError with one line: missing, a folder, unreadable, not TOML.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: cannot be read: no such {what}") from None
    except IsADirectoryError:
        raise ConfigurationError(f"{path}: is a folder; name a TOML file") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: is not TOML: it contains bytes that are not UTF-8 text") from None
    except ValueError as error:
        raise ConfigurationError(f"{str(path)!r}: is not the name of a file ({error})") from None
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ConfigurationError(f"{path}: is not TOML: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{path}: is not TOML: {error}{_hint(str(error), text)}") from None


def _hint(said: str, text: str) -> str:
    """What is usually meant by a slip that TOML's own words do not name."""
    place = re.search(r"at line (\d+)", said)
    line = text.splitlines()[int(place[1]) - 1] if place and int(place[1]) <= text.count("\n") + 1 else ""
    if said.startswith(_TWICE):
        return "; this is stated twice"
    if number := re.search(r"=\s*([+-]?\d+),(\d+)", line):
        return f"; a decimal point is meant: {number[1]}.{number[2]}"
    if re.fullmatch(r"\s*[\w.]+\s*=\s*[A-Za-z_].*", line):
        return "; put text in quotes"
    return ""
