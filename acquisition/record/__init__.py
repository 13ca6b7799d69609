"""MCAP records: schemas, writer, reader, recovery."""

import re
from pathlib import Path

from processing.errors import ConfigurationError

PIXELS_SUFFIX = ".pixels.mcap"


def recovery_path(record: Path) -> Path:
    """Path of the recovered copy of a record; commands on folders read that copy where it exists."""
    return record.with_name(f"{record.stem}-recovered{record.suffix}")


def pixels_path(record: Path) -> Path:
    """Path of the file of pixels of a record; the record is complete without that file."""
    return record.with_name(f"{record.stem}{PIXELS_SUFFIX}")


def is_pixel_file(path: Path) -> bool:
    """Whether a file is the file of pixels of a record, and not a record."""
    return path.name.endswith(PIXELS_SUFFIX)


def records_in_folder(folder: Path, pattern: str = "*.mcap") -> list[Path]:
    """The records in a folder whose names match, sorted by name."""
    return sorted(path for path in folder.glob(pattern) if path.is_file() and not is_pixel_file(path))


def resolve_records(path: Path) -> list[Path]:
    """The record at `path`, or the records of a session's folder by run number; a recovered copy replaces it.

    Raises ConfigurationError for a folder without records.
    """
    if not path.is_dir():
        return [path]
    runs = sorted(
        (int(match[1]), file)
        for file in records_in_folder(path, "run-*.mcap")
        if (match := re.fullmatch(r"run-(\d+)", file.stem))
    )
    records = [copy if (copy := recovery_path(file)).exists() else file for _, file in runs]
    records = records or records_in_folder(path)
    if records:
        return records
    raise ConfigurationError(f"{path}: holds no record (run-1.mcap, ...); name one, or a session's folder")
