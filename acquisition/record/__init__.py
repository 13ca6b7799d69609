"""MCAP records: schemas, writer, reader, recovery."""

from pathlib import Path

PIXELS_SUFFIX = ".pixels.mcap"


def recovered_beside(record: Path) -> Path:
    """Where the recovered copy of a record lies, if there is one: commands on folders read it instead."""
    return record.with_name(f"{record.stem}-recovered{record.suffix}")


def pixels_beside(record: Path) -> Path:
    """Where the pixels of a record lie; it is whole without them."""
    return record.with_name(f"{record.stem}{PIXELS_SUFFIX}")


def is_pixels(path: Path) -> bool:
    """Whether a file has the pixels of a record, and is none itself."""
    return path.name.endswith(PIXELS_SUFFIX)


def records_of(folder: Path, pattern: str = "*.mcap") -> list[Path]:
    """The records in a folder whose names match, sorted by name."""
    return sorted(path for path in folder.glob(pattern) if path.is_file() and not is_pixels(path))
