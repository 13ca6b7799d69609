"""What a desk shows of a run is read from its record, while it grows."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.record.topics import RecordedFittedPoint
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD, nanoseconds
from rig.desk.run_reader import RecordFollower, decimated
from tests.waiting import until

SPOT = Spot(3.0, 2.0, 0.01, 0.01, 1.5, 1.4, 0.0, 100.0, 4.0, 1.0, 0)


@pytest.fixture
def events() -> list[dict[str, Any]]:
    return []


@pytest.fixture
def reader(tmp_path: Path, events: list[dict[str, Any]]) -> Iterator[RecordFollower]:
    """A reader that puts its events into the list `events`."""
    found = RecordFollower(tmp_path / "run-1.mcap", events.append)
    yield found
    found.close()


def writer(path: Path) -> RecordWriter:
    """A record that began with a frame 3 s ago, at 50 s of the frames' clock."""
    start_ns = nanoseconds(50.0)
    return RecordWriter(path, time.time_ns() - nanoseconds(3.0) - start_ns, deflection_unit=DeflectionUnit.PX)


def spots(record: RecordWriter, at_s: float, count: int = 16) -> None:
    times_ns = nanoseconds(50.0 + at_s) + np.arange(count, dtype=np.int64) * 10_000_000
    zeros = np.zeros(count)
    at = Deflections(times_ns, zeros, zeros + at_s, zeros, zeros, DeflectionUnit.PX)
    record.write_spots(range(count), times_ns.tolist(), times_ns.tolist(), [SPOT] * count, at)


def test_a_growing_record_is_shown_as_it_is_flushed_and_the_next_one_of_its_name(
    reader: RecordFollower, events: list[dict[str, Any]]
) -> None:
    assert not reader.begun
    with writer(reader.record) as record:
        spots(record, 0.0)
        record.write_event(nanoseconds(50.0), "start", "first frame")
        record.flush()
        until(lambda: reader.begun and bool(reader.path()["y"]))
        assert reader.path()["y"] == [0.0] * 16
        until(lambda: bool(events))
        (event,) = events
        assert event["kind"] == "start"
        assert 3.0 <= time.time() - event["time_s"] < 60.0
        spots(record, 1.0)
        record.flush()
        until(lambda: len(reader.path()["y"]) == 32)
    # a start that is not accepted is set aside, and the record begins again
    reader.record.rename(reader.record.with_name("run-1-start-1.mcap"))
    with writer(reader.record) as record:
        spots(record, 0.5, 4)
        record.flush()
        until(lambda: reader.path()["y"] == [0.5] * 4)


def test_the_fit_is_told_at_the_times_of_the_record(reader: RecordFollower) -> None:
    start_ns = nanoseconds(50.0)
    with writer(reader.record) as record:
        spots(record, 0.0)
        half_cycle = HalfCycle(0, start_ns + nanoseconds(1.0), 1e-4, 3.0, 0.1, 2.0, 1e-4, 0.0, 1, 0)
        record.write_half_cycle(half_cycle)
        for at_s in (10.0, 12.0):
            time_ns = start_ns + nanoseconds(at_s)
            amplitude_rad = at_s * ARCSEC_RAD
            point = RecordedFittedPoint(time_ns, start_ns + nanoseconds(1.0), amplitude_rad, 0.1, 4.01, 0.25)
            record.write(point)
            record.flush()
            # that of an earlier fit is forgotten
            until(lambda: reader.history()["fit"] == [(1.0, at_s)])  # noqa: B023
    assert reader.history()["measured"] == [(1.0, 3.0)]


def test_a_long_run_is_drawn_in_some_hundred_points_up_to_its_last() -> None:
    points = [(float(k), 0.5 * k) for k in range(10_001)]
    found = decimated(points)
    assert 400 < len(found) <= 800
    assert (found[-1], sorted(found)) == (points[-1], found)
    assert decimated(points[:7]) == points[:7]
