"""Writes a calibration file with its author, date, validity and sources."""

import datetime
import getpass
import socket
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import atomic_write
from acquisition.record.digest import sha256_of
from calibration import CalibrationFile, Kind, Source, write_calibration
from processing.errors import ConfigurationError
from rig.instrument import versions

_SHORTEST_DAYS, _LONGEST_DAYS = 0.01, 36_525.0


@dataclass(frozen=True, slots=True)
class Filing:
    """Folder, author and validity of a calibration; raises ConfigurationError for an impossible validity."""

    folder: Path
    valid_days: float = 90.0
    made_by: str = ""

    def __post_init__(self) -> None:
        # a NaN is in no range
        if not _SHORTEST_DAYS <= self.valid_days <= _LONGEST_DAYS:
            raise ConfigurationError(
                f"valid for {self.valid_days:g} days: should be from {_SHORTEST_DAYS:g} to {_LONGEST_DAYS:g}"
            )


def file_calibration(
    kind: Kind,
    filing: Filing,
    method: str,
    values: Mapping[str, Any],
    details: Mapping[str, Any],
    sources: Sequence[Path],
    notes: Sequence[str] = (),
    measured_at: datetime.datetime | None = None,
) -> Path:
    """Write one calibration, valid from `measured_at` (None: now) on; returns the file.

    `values` fill a section of the configuration, `details` are shown in a report, `sources` are the
    files used, whose hashes are stored.
    """
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    measured_at = measured_at or now
    valid_until = measured_at + datetime.timedelta(days=filing.valid_days)
    used = [Source(name=path.name, sha256=sha256_of(path)) for path in sources if path.is_file()]
    calibration = CalibrationFile(
        kind=kind,
        made_by=filing.made_by or _user(),
        made_at=now,
        valid_until=valid_until.replace(microsecond=0),
        measured_at=measured_at,
        host=socket.gethostname(),
        software=f"optical-pendulum-rig {versions()['optical-pendulum-rig']}",
        method=method,
        sources=tuple(used),
        notes=tuple(notes),
        values=dict(values),
        details=dict(details),
    )
    return write_calibration(filing.folder, calibration, atomic_write.write_new)


def next_free(folder: Path, stem: str, suffix: str = "") -> Path:
    """The first of STEM-001, STEM-002 ... that does not exist."""
    number = 1
    while (path := folder / f"{stem}-{number:03d}{suffix}").exists():
        number += 1
    return path


def details_of(found: Any, *left_out: str) -> dict[str, Any]:
    """Fields of a dataclass as plain values for a calibration file: arrays as lists, parts as tables."""
    return {name: _plain(value) for name, value in asdict(found).items() if name not in left_out}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list | tuple) else value


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return ""
