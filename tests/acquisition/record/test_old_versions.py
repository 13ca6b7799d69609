"""Records of all versions can be read: one small file of each version is kept, with its content.

To keep one of a new version: ``python -m tests.acquisition.record.test_old_versions``; it overwrites nothing.
"""

import hashlib
import json
import sys
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.record.check import check_record
from acquisition.record.reader import RecordReader
from acquisition.record.topics import SCHEMA_VERSION, Environment
from tests.acquisition.record.samples import SampleBalance, write_sample

FOLDER = Path(__file__).parent / "data"
VERSIONS = [1, 2]


def summary(path: Path) -> dict[str, Any]:
    """What is in a record, numbers of full width as text."""
    with RecordReader(path) as reader:
        spots = reader.spots()
        windows = hashlib.sha256(b"".join(window.image.tobytes() for window in reader.windows()))
        images = hashlib.sha256(b"".join(frame.image.tobytes() for frame in reader.images()))
        return {
            "deflection_unit": reader.deflection_unit,
            "epoch_offset_ns": reader.epoch_offset_ns,
            "session": reader.metadata["session"],
            "attachments": {name: data.hex() for name, data in reader.attachments.items()},
            "spots": {name: _column(spots[name]) for name in spots.dtype.names or ()},
            "swings": [_exact(astuple(swing)) for swing in reader.swings()],
            "balances": [_exact(astuple(value)) for value in reader.values("/balance", SampleBalance)],
            "environment": [_exact(value) for value in reader.values("/environment", Environment)],
            "events": [list(event) for event in reader.events()],
            "log": [list(line) for line in reader.log()],
            "windows": [[window.sequence, *window.origin_px] for window in reader.windows()],
            "window_pixels_sha256": windows.hexdigest(),
            "image_pixels_sha256": images.hexdigest(),
        }


def _column(values: np.ndarray) -> list[Any]:
    return _exact(values.tolist())


def _exact(values: Any) -> list[Any]:
    return [value.hex() if isinstance(value, float) else value for value in values]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_record_of_every_version_is_read_to_the_last_bit(version: int) -> None:
    path = FOLDER / f"record-v{version}.mcap"
    assert summary(path) == json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    assert check_record(path) == []


def test_every_version_up_to_todays_is_kept() -> None:
    assert list(range(1, SCHEMA_VERSION + 1)) == VERSIONS
    assert all((FOLDER / f"record-v{version}.mcap").stat().st_size < 100_000 for version in VERSIONS)


if __name__ == "__main__":
    new = FOLDER / f"record-v{SCHEMA_VERSION}.mcap"
    if new.exists():
        sys.exit(f"{new} exists already")
    write_sample(new, 48)
    new.with_suffix(".json").write_text(json.dumps(summary(new), indent=1, ensure_ascii=False) + "\n")
