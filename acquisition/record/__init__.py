"""MCAP records: schemas, writer, reader, recovery."""

from pathlib import Path


def recovered_beside(record: Path) -> Path:
    """Where the recovered copy of a record lies, if there is one: commands on folders read it instead."""
    return record.with_name(f"{record.stem}-recovered{record.suffix}")
