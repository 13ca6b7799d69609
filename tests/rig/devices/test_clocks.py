"""Clocks of a run: the rate of the camera's, anchors of UTC, steps of the clock of the day."""

import time

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.record.events import EventKind
from acquisition.record.topics import RecordedClockStep
from processing.errors import DeviceError
from rig.devices import clocks
from rig.devices.clocks import ClockAnchors, ClockRate, HostClockReading, read_clocks
from rig.instrument import CameraClock
from rig.measure.run import utc_offset_ns

IMAGE = np.zeros((2, 2), np.uint8)
RATE_HZ = 50.0


def frames(seconds: float, drift_ppm: float, *, clock: bool = True) -> list[Frame]:
    """Frames of a camera whose clock runs fast, which arrive half a millisecond late on average."""
    rng = np.random.default_rng(3)
    true_ns = np.arange(round(seconds * RATE_HZ)) * 1e9 / RATE_HZ
    device_ns = 10**9 + np.round(true_ns * (1 + 1e-6 * drift_ppm)).astype(np.int64)
    host_ns = 10**12 + np.round(true_ns + 5e5 * rng.exponential(size=len(true_ns))).astype(np.int64)
    host_ns = np.maximum.accumulate(host_ns)
    times = zip(device_ns.tolist(), host_ns.tolist(), strict=True)
    return [Frame(IMAGE, n, device if clock else -1, host) for n, (device, host) in enumerate(times)]


def read(given: list[Frame], size: int = 5, steps: tuple[RecordedClockStep, ...] = ()) -> list[CameraClock]:
    rate, found = ClockRate(), list[CameraClock]()
    for first in range(0, len(given), size):
        found.append(rate.take(given[first : first + size], steps if not first else ()))
        if rate._fit is not None:
            rate._fit.result()
    return found


@pytest.mark.parametrize("drift_ppm", [-40.0, 75.0])
def test_the_rate_is_known_within_its_uncertainty_ever_more_closely(drift_ppm: float) -> None:
    estimates = read(frames(60.0, drift_ppm), size=10)
    # of 3 s of frames, five blocks a second, and with more pairs than are kept
    assert [one.is_known for one in estimates].index(True) == 16
    found = estimates[16:]
    assert abs(found[-1].drift_ppm - drift_ppm) < 4.0 * found[-1].u_drift_ppm
    assert found[0].u_drift_ppm > 20.0 * found[-1].u_drift_ppm


def test_steps_are_counted_with_the_largest() -> None:
    steps = (RecordedClockStep(0, 130_000_000, 1000), RecordedClockStep(1, -2_000_000_000, 1000))
    now = read(frames(1.0, 0.0), steps=steps)[-1]
    assert (now.steps, now.largest_step_s) == (2, -2.0)
    assert now.text == "stepped 2 times, at most by -2 s"
    assert CameraClock(30.0, 0.25, 1, 0.13).text == (
        "+30.00 ± 0.25 ppm against the computer's, stepped once by +0.13 s"
    )


def test_a_camera_without_a_clock_has_no_rate_and_few_frames_tell_none() -> None:
    assert read(frames(60.0, 0.0, clock=False))[-1].text == ""
    early = read(frames(3.5, 0.0), size=40)[-1]
    assert (early.is_known, early.steps, early.largest_step_s, early.text) == (False, 0, 0.0, "")


def test_what_fails_in_the_thread_is_raised_where_the_wall_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ValueError("no line")

    monkeypatch.setattr(clocks, "relate_clocks", fails)
    rate = ClockRate()

    def take() -> None:
        rate.take(frames(10.0, 0.0))
        assert rate._fit is not None
        rate._fit.exception()
        rate.take([])

    with pytest.raises(ValueError, match="no line"):
        take()
    assert rate.take([]).text == ""


class Clocks:
    """Clocks that are moved on by hand, and read instead of the computer's."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.host_ns = 5_000_000_000
        self.utc_ns = 1_790_000_000_000_000_000
        monkeypatch.setattr(clocks, "read_clocks", self)

    def __call__(self) -> HostClockReading:
        return HostClockReading(self.host_ns, self.utc_ns, 400)

    def pass_s(self, host: float, day: float | None = None) -> None:
        self.host_ns += round(host * 1e9)
        self.utc_ns += round((host if day is None else day) * 1e9)


def test_an_anchor_every_ten_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    by_hand, anchors = Clocks(monkeypatch), ClockAnchors()
    found = []
    for second in range(31):
        anchor, events = anchors.take(second)
        assert events == []
        found += [] if anchor is None else [anchor]
        by_hand.pass_s(1.0)
    assert [anchor.time_ns for anchor in found] == [0, 10, 20, 30]
    assert found[1].utc_ns - found[0].utc_ns == found[1].host_time_ns - found[0].host_time_ns


def test_a_step_is_an_event_and_a_slew_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    by_hand, anchors = Clocks(monkeypatch), ClockAnchors()
    anchors.take(0)
    by_hand.pass_s(5.0, 5.0065)
    assert anchors.take(1) == (None, [])
    by_hand.pass_s(0.5, 0.5035)
    assert [event.text[-8:] for event in anchors.take(1)[1]] == ["+0.004 s"]
    by_hand.pass_s(0.5, -0.75)
    anchor, (event,) = anchors.take(2)
    assert (event.kind, event.time_ns) == (EventKind.CLOCK_STEP, 2)
    assert event.text == "the computer's clock of the day moved by -1.250 s"
    assert anchor is not None
    assert anchor.utc_ns == by_hand.utc_ns


def test_both_clocks_are_read_at_once() -> None:
    first, second = read_clocks(), read_clocks()
    assert 0 <= first.duration_ns < 10**9
    assert second.host_time_ns > first.host_time_ns


def test_a_clock_of_the_day_before_1970_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = Frame(np.zeros((2, 2), np.uint8), 0, 5, time.monotonic_ns())
    assert abs(utc_offset_ns(frame) + 5 - time.time_ns()) < 60 * 10**9
    monkeypatch.setattr(time, "time_ns", lambda: -1)
    with pytest.raises(DeviceError, match="before 1970; set it"):
        utc_offset_ns(frame)
