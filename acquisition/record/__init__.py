"""MCAP records: schemas, writer, reader, recovery."""

import re
from pathlib import Path

from processing.errors import ConfigurationError


def recovered_beside(record: Path) -> Path:
    """Where the recovered copy of a record lies, if there is one: commands on folders read it instead."""
    return record.with_name(f"{record.stem}-recovered{record.suffix}")


def records_in(path: Path) -> list[Path]:
    """The record itself, or those of a session's folder in their order; instead of one its recovered copy.

    Raises ConfigurationError for a folder without records.
    """
    if not path.is_dir():
        return [path]
    runs = sorted(
        (int(found[1]), file)
        for file in path.glob("run-*.mcap")
        if (found := re.fullmatch(r"run-(\d+)", file.stem))
    )
    records = [copy if (copy := recovered_beside(file)).exists() else file for _, file in runs]
    records = records or sorted(path.glob("*.mcap"))
    if records:
        return records
    raise ConfigurationError(f"{path}: holds no record (run-1.mcap, ...); name one, or a session's folder")
