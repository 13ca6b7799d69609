"""UTC is anchored again and again; a step of the clock of the day is an event."""

import time

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.record.events import EventKind
from processing.errors import DeviceError
from rig.devices.clocks import ClockAnchors, HostClockReading, read_clocks
from rig.measure.run import utc_offset_ns


class Clocks:
    """Clocks that are moved on by hand."""

    def __init__(self) -> None:
        self.host_ns = 5_000_000_000
        self.utc_ns = 1_790_000_000_000_000_000

    def __call__(self) -> HostClockReading:
        return HostClockReading(self.host_ns, self.utc_ns, 400)

    def pass_s(self, host: float, day: float | None = None) -> None:
        self.host_ns += round(host * 1e9)
        self.utc_ns += round((host if day is None else day) * 1e9)


def test_an_anchor_every_ten_seconds() -> None:
    clocks = Clocks()
    anchors = ClockAnchors(clocks)
    found = []
    for second in range(31):
        anchor, events = anchors.take(second)
        assert events == []
        found += [] if anchor is None else [anchor]
        clocks.pass_s(1.0)
    assert [anchor.time_ns for anchor in found] == [0, 10, 20, 30]
    assert found[1].utc_ns - found[0].utc_ns == found[1].host_time_ns - found[0].host_time_ns


def test_a_step_is_an_event_and_a_slew_is_none() -> None:
    clocks = Clocks()
    anchors = ClockAnchors(clocks)
    anchors.take(0)
    clocks.pass_s(5.0, 5.0025)
    assert anchors.take(1) == (None, [])
    clocks.pass_s(0.5, -0.75)
    anchor, (event,) = anchors.take(2)
    assert (event.kind, event.time_ns) == (EventKind.CLOCK_STEP, 2)
    assert event.text == "the computer's clock of the day moved by -1.250 s"
    assert anchor is not None
    assert anchor.utc_ns == clocks.utc_ns


def test_both_clocks_are_read_at_once() -> None:
    first, second = read_clocks(), read_clocks()
    assert 0 <= first.apart_ns < 10**9
    assert second.host_time_ns > first.host_time_ns


def test_a_clock_of_the_day_before_1970_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = Frame(np.zeros((2, 2), np.uint8), 0, 5, time.monotonic_ns())
    assert abs(utc_offset_ns(frame) + 5 - time.time_ns()) < 60 * 10**9
    monkeypatch.setattr(time, "time_ns", lambda: -1)
    with pytest.raises(DeviceError, match="before 1970; set it"):
        utc_offset_ns(frame)
