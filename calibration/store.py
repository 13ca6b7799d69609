"""Calibration files in TOML, with provenance; a new file never overwrites an older one."""

import datetime
import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, Field, ValidationError

from processing.errors import ConfigurationError, RecordError, require_schema
from processing.fault_text import fault_text

Kind = Literal["lever", "axes", "sensor", "clock", "shutter", "air", "pointing", "check"]
SCHEMA = 1


class Source(BaseModel, frozen=True, extra="forbid"):
    """A file from which the calibration was made."""

    name: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


class CalibrationFile(BaseModel, frozen=True, extra="forbid"):
    """Content of one calibration file.

    `values` fill the section of the configuration of `kind`, `details` are further results, as plain values
    for a report. `method` and `notes` are text for the user. Times include the offset from UTC.
    """

    schema_version: int = SCHEMA
    kind: Kind
    made_by: str = ""
    made_at: datetime.datetime
    valid_until: datetime.datetime
    host: str = ""
    software: str = ""
    method: str = ""
    measured_at: datetime.datetime
    sources: tuple[Source, ...] = ()
    notes: tuple[str, ...] = ()
    values: dict[str, Any] = Field(default_factory=dict)
    details: dict[str, Any] = Field(default_factory=dict)

    def expired(self, at: datetime.datetime) -> bool:
        """Whether the calibration was no longer valid at this time."""
        return at > self.valid_until


def write_calibration(
    folder: Path, calibration: CalibrationFile, write_new: Callable[[Path, bytes], None]
) -> Path:
    """Write a calibration to KIND-001.toml, KIND-002.toml ... (the next number) and return the path.

    `write_new` writes a file whole or not at all, and raises FileExistsError where the file exists. Raises
    RecordError if the calibration cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        numbers = [
            int(match.group(1))
            for path in folder.iterdir()
            if (match := re.fullmatch(rf"{calibration.kind}-(\d+)\.toml", path.name))
        ]
        path = folder / f"{calibration.kind}-{max(numbers, default=0) + 1:03d}.toml"
        write_new(path, toml_text(calibration).encode())
    except OSError as error:
        raise RecordError(f"{folder}: cannot write the calibration: {error.strerror or error}") from None
    return path


def read_calibration(path: Path, kind: Kind | None = None) -> CalibrationFile:
    """Read a calibration file.

    Raises ConfigurationError if it cannot be read, is not a calibration, or is not of this `kind`.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot read the calibration: {error.strerror or error}") from None
    except ValueError as error:
        raise ConfigurationError(f"{str(path)!r}: is not the name of a file ({error})") from None
    return parse_calibration(data, str(path), kind)


def parse_calibration(data: bytes, name: str, kind: Kind | None = None) -> CalibrationFile:
    """Parse the content of a calibration file, as a record stores it; `name` is used in messages.

    Raises ConfigurationError as `read_calibration` does.
    """
    try:
        tree = tomllib.loads(data.decode("utf-8"))
        require_schema(name, tree.get("schema_version", SCHEMA), SCHEMA, ConfigurationError)
        calibration = CalibrationFile.model_validate(tree)
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigurationError(f"{name}: is not TOML: {error}") from None
    except ValidationError as error:
        raise ConfigurationError(
            f"{name}: is not a calibration file ({fault_text(error.errors()[0])}); rig calibrate makes one"
        ) from None
    for field in ("made_at", "valid_until", "measured_at"):
        if getattr(calibration, field).tzinfo is None:
            raise ConfigurationError(
                f"{name}: {field} has no offset from UTC; write it as 2026-01-31T12:00:00Z"
            )
    if kind is not None and calibration.kind != kind:
        raise ConfigurationError(f"{name}: is a calibration of {calibration.kind}; one of {kind} is needed")
    return calibration


def toml_text(calibration: CalibrationFile) -> str:
    """The calibration as TOML."""
    plain = calibration.model_dump()
    lines = ["# Made by rig calibrate; [values] fill the configuration. Do not edit: make a new calibration."]
    tables = {key: plain.pop(key) for key in ("values", "details")}
    sources = plain.pop("sources")
    lines += [f"{key} = {toml_value(value)}" for key, value in plain.items()]
    for source in sources:
        lines += ["", "[[sources]]", *(f"{key} = {toml_value(value)}" for key, value in source.items())]
    for name, table in tables.items():
        lines += ["", f"[{name}]"]
        lines += [f"{key} = {toml_value(value)}" for key, value in table.items() if value is not None]
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """A plain value as TOML writes it; a mapping becomes an inline table without the keys that are None."""
    if isinstance(value, Path):
        value = value.as_posix()
    if isinstance(value, datetime.datetime):
        return value.isoformat(timespec="seconds")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are valid in TOML, but JSON leaves the delete character as it is, which TOML forbids
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else "nan" if math.isnan(value) else f"{value:+}"
    if isinstance(value, Mapping):
        pairs = (f"{json.dumps(str(key))} = {toml_value(v)}" for key, v in value.items() if v is not None)
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    raise TypeError(f"{type(value).__name__} cannot be written in TOML")
