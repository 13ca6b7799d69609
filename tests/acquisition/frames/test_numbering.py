"""A camera's clock that errs: nothing of it ends a run, and every frame keeps a time or is counted."""

import time
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.camera import Frame
from acquisition.frames.numbering import FrameLine
from acquisition.record.topics import RecordedClockStep

IMAGE = np.zeros((2, 2), np.uint8)
RATE_HZ = 25.0
INTERVAL_NS = round(1e9 / RATE_HZ)
HOST_NS = time.monotonic_ns() - 10**14
"""No frame of these hours is in the future of the computer's clock, which a line refuses."""


class Carried(NamedTuple):
    """What a line lets through of a camera's frames, and says of them."""

    frames: list[Frame]
    clock: FrameLine

    notes: list[str]
    steps: list[RecordedClockStep]


def joined(device_ns: list[int], late_ms: list[float] | None = None) -> Carried:
    """Frames that a line lets through, of times at a steady rate."""
    rng = np.random.default_rng(5)
    delays_ms = [abs(rng.normal(1.0, 0.5)) + late for late in late_ms or [0.0] * len(device_ns)]
    return carried(device_ns, [HOST_NS + n * INTERVAL_NS + round(1e6 * ms) for n, ms in enumerate(delays_ms)])


def carried(times: list[int], host_ns: list[int], numbers: Iterable[int] | None = None) -> Carried:
    """Frames with numbers that go on whatever is lost, as of a camera that was reset."""
    line, numbers = FrameLine(in_real_time=True), numbers or range(len(times))
    read = [Frame(IMAGE.copy(), *one) for one in zip(numbers, times, host_ns, strict=True)]
    frames = [frame for one in read for frame in line.take(one)]
    return Carried(frames, line, [text for _, text in line.events], list(line.steps))


def steady(count: int = 300) -> list[int]:
    rng = np.random.default_rng(4)
    return [10**9 + n * INTERVAL_NS + round(2e3 * rng.normal()) for n in range(count)]


def off_ns(frames: list[Frame]) -> float:
    """Largest distance of the times from those of a clock that never erred."""
    first = frames[0]
    return max(
        abs(frame.device_time_ns - first.device_time_ns - (frame.sequence - first.sequence) * INTERVAL_NS)
        for frame in frames
    )


@pytest.mark.parametrize("wrong", [0, 9 * 10**18, 2**63 + 5, 2**64 - 1, 10**9 + 3, 10**9 + 140 * INTERVAL_NS])
def test_a_single_wrong_time_is_left_out_and_counted(wrong: int) -> None:
    times = steady()
    times[100] = wrong
    frames, clock, notes, _ = joined(times)
    assert [frame.sequence for frame in frames] == [n for n in range(300) if n != 100]
    assert clock.rejected == 1
    # the others keep theirs to the nanosecond
    assert [frame.device_time_ns for frame in frames] == times[:100] + times[101:]
    assert len(notes) == 1
    assert off_ns(frames) < 20e3


@pytest.mark.parametrize("step_ms", [130.0, -130.0, 15.0, -15.0, 60.0, 3.6e6, -900.0])
def test_a_step_is_found_named_and_taken_off(step_ms: float) -> None:
    step_ns = round(step_ms * 1e6)
    times = [t + step_ns * (n >= 120) for n, t in enumerate(steady())]
    frames, clock, notes, _ = joined(times)
    assert [frame.sequence for frame in frames] == list(range(300))
    assert clock.rejected == 0
    assert len(notes) == 1
    told_s = float(notes[0].split("stepped by ")[1].split(" s")[0])
    assert told_s == pytest.approx(step_ms / 1e3, abs=2e-5)
    assert "before frame 120" in notes[0]
    assert off_ns(frames) < 20e3


def test_a_counter_of_32_bits_is_unwrapped_and_said_once_after_its_first() -> None:
    times = [t % 2**32 for t in steady(700)]
    frames, clock, notes, _ = joined(times)
    assert [frame.sequence for frame in frames] == list(range(700))
    assert clock.wraps >= 4
    assert len(notes) == 2
    assert "begins again every 4.295 s" in notes[1]
    assert off_ns(frames) < 40e3


def test_a_first_time_that_is_wrong_moves_the_others() -> None:
    frames, _, notes, _ = joined([0, *steady()[1:]])
    assert [frame.sequence for frame in frames] == list(range(300))
    assert len(notes) == 1
    assert off_ns(frames) < 5e6


@settings(max_examples=30, deadline=None)
@given(
    late=st.lists(st.floats(0.0, 2000.0), min_size=1, max_size=5),
    lost=st.lists(st.integers(20, 280), max_size=20),
)
def test_frames_that_are_read_late_or_lost_are_no_fault_of_the_clock(
    late: list[float], lost: list[int]
) -> None:
    """A host that hangs reads what waited at once, when it goes on."""
    behind = np.zeros(300)
    for place, late_ms in enumerate(late):
        at = 40 + 50 * place
        behind[at:] = np.maximum(behind[at:], late_ms - 40.0 * np.arange(300 - at))
    times = steady()
    frames, clock, notes, _ = joined(times, behind.tolist())
    assert (len(frames), clock.rejected, notes) == (300, 0, [])
    kept = [n for n in range(300) if n not in lost]
    again = carried([times[n] for n in kept], [HOST_NS + n * INTERVAL_NS for n in kept], kept)
    assert len(again.frames) == len(kept)


def test_a_rate_that_changes_is_no_step() -> None:
    times = np.cumsum([INTERVAL_NS] * 100 + [2 * INTERVAL_NS] * 100 + [INTERVAL_NS // 2] * 100).tolist()
    frames, clock, _, _ = carried(times, [HOST_NS + t + 10**6 * (n % 3) for n, t in enumerate(times)])
    assert (len(frames), clock.rejected) == (300, 0)


def arrivals(times: list[int]) -> list[int]:
    rng = np.random.default_rng(6)
    return [HOST_NS + t + round(1e6 * abs(rng.normal(1.0, 0.3))) for t in times]


def hanging(true: list[int], *hangs: tuple[int, int]) -> list[int]:
    """Arrivals at a reader that hangs from one frame to another, and then reads all at once."""
    host = arrivals(true)
    for first, until in hangs:
        for n in range(first, until):
            host[n] = host[until] - 10_000 * (until - n)
    return host


@pytest.mark.parametrize(("reset", "later_ns"), [(120, 0), (600, 12_000_000)])
def test_where_frames_without_numbers_are_missing_the_computer_s_clock_says_the_step(
    reset: int, later_ns: int
) -> None:
    """The camera was reset for 0.98 s: its clock begins again, and its numbers go on by one.

    A computer that has been busy for some time, and reads all frames later, makes the step no smaller.
    """
    true = [n * INTERVAL_NS + (980_000_000 if n >= reset else 0) for n in range(reset + 180)]
    shown = [t + 7 * 10**9 if n < reset else t - true[reset] for n, t in enumerate(true)]
    host = [ns + later_ns * (n >= 50) for n, ns in enumerate(arrivals(true))]
    frames, _, notes, _ = carried(shown, host)
    assert [frame.sequence for frame in frames] == list(range(reset + 180))
    assert max(abs(frame.device_time_ns - 7 * 10**9 - true[frame.sequence]) for frame in frames) < 3e6
    assert len(notes) == 1


def test_a_step_while_the_reader_hangs_is_as_exact_as_the_camera_s_rate() -> None:
    times = [t + 130_000_000 * (n >= 120) for n, t in enumerate(steady())]
    frames, _, notes, _ = carried(times, hanging([n * INTERVAL_NS for n in range(300)], (118, 134)))
    assert len(frames) == 300
    assert len(notes) == 1
    assert off_ns(frames) < 20e3


def test_a_step_that_must_be_decided_before_the_reader_is_up_says_how_little_is_known_of_it() -> None:
    """No room is left for frames that wait; whichever clock was right, the uncertainty covers it."""
    clock = FrameLine(in_real_time=True)
    image = np.zeros((1024, 2048), np.uint8)
    true = [n * INTERVAL_NS + 5 * INTERVAL_NS * (n >= 120) for n in range(200)]
    host = arrivals(true)
    for n in range(110, 200):
        host[n] = host[199] + 10_000 * (n - 199)
    frames = [f for n, t in enumerate(true) for f in clock.take(Frame(image, n, t, host[n]))]
    (step,) = clock.steps
    assert len(frames) > 190
    assert all(abs(frame.device_time_ns - true[frame.sequence]) <= step.u_step_ns for frame in frames[120:])


@pytest.mark.parametrize("shows", ["frozen", "nothing", "anything"])
def test_a_clock_that_makes_no_sense_any_more_is_given_up_and_the_computer_s_carries_on(shows: str) -> None:
    rng = np.random.default_rng(8)
    wrong = {
        "frozen": [steady()[120]] * 300,
        "nothing": [2**64 - 1] * 300,
        "anything": rng.integers(0, 2**62, 300).tolist(),
    }[shows]
    times = [t if n < 120 else wrong[n] for n, t in enumerate(steady())]
    frames, clock, notes, (step,) = joined(times)
    assert [frame.sequence for frame in frames] == list(range(300))
    assert clock.rejected == 0
    assert len(notes) == 1
    first = 121 if shows == "frozen" else 120
    # a step of 0 says in the record that the clock is no longer used
    assert (step.time_ns, step.step_ns, step.u_step_ns > 0) == (frames[first].time_ns, 0, True)
    assert f"is abandoned from frame {first} on" in notes[0]
    assert "restart the camera" in notes[0]
    assert off_ns(frames) < 5e6
    intervals_ns = np.diff([frame.device_time_ns for frame in frames])
    assert intervals_ns.min() > 0
    # the computer reads each frame to 0.5 ms; the camera's rate carries more than single readings
    assert np.std(intervals_ns[130:]) < 50e3


def test_a_clock_that_never_shows_a_time_is_given_up_at_the_start() -> None:
    frames, _, notes, _ = joined([2**64 - 1] * 50)
    assert [frame.sequence for frame in frames] == list(range(50))
    assert frames[0].device_time_ns == frames[0].host_time_ns, "nothing is known of a delay"
    assert len(notes) == 1
    assert off_ns(frames) < 5e6


def test_a_step_says_its_size_and_what_is_not_known_of_it() -> None:
    shown = [(t + 130_000_000 * (n >= 120)) % 2**32 for n, t in enumerate(steady())]
    _, clock, _, (step,) = carried(shown, [HOST_NS + n * INTERVAL_NS for n in range(300)])
    assert clock.wraps == 2
    assert abs(step.step_ns - 130_000_000) < 4 * step.u_step_ns < 100_000


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 30.0])
def test_first_frames_that_waited_for_their_reader_are_no_step(rate_hz: float) -> None:
    """All that came while the program began is read at once: the first by far later than the fourth."""
    each_ns = round(1e9 / rate_hz)
    times = [10**9 + n * each_ns for n in range(60)]
    host_ns = [max(HOST_NS + t, HOST_NS + times[3] + 5_000_000 + n * 300_000) for n, t in enumerate(times)]
    frames, _, notes, _ = carried(times, host_ns)
    assert notes == []
    assert [frame.device_time_ns for frame in frames] == times


@settings(max_examples=80, deadline=None)
@given(
    rate_hz=st.sampled_from([5.0, 30.0, 200.0]),
    late_ms=st.lists(st.floats(0.0, 400.0), min_size=12, max_size=12),
    lost=st.sets(st.integers(1, 12), max_size=6),
    step_ms=st.sampled_from([0.0, 0.0, 130.0, -130.0, 2000.0]),
    at=st.integers(2, 40),
)
def test_times_never_run_backwards_however_irregularly_a_camera_without_numbers_begins(
    rate_hz: float, late_ms: list[float], lost: set[int], step_ms: float, at: int
) -> None:
    each_ns = round(1e9 / rate_hz)
    true = [n * each_ns for n in range(60) if n not in lost]
    late = [*late_ms, *[0.0] * 60]
    read_ns = np.maximum.accumulate([t + round(1e6 * late[n]) + 1000 * n for n, t in enumerate(true)])
    times = [10**9 + t + round(1e6 * step_ms) * (n >= at) for n, t in enumerate(true)]
    frames = carried(times, [HOST_NS + int(ns) for ns in read_ns]).frames
    found = [frame.device_time_ns for frame in frames]
    assert all(later > earlier for earlier, later in pairwise(found))


def rising_by(intervals: list[int]) -> list[int]:
    return [0, *np.cumsum(intervals).tolist()]


def with_gaps(count: int, gaps: dict[int, int], rate: int = 1) -> list[int]:
    """Times with gaps without numbers before some frames, and another rate from frame 116 on."""
    each_ns = [INTERVAL_NS // (rate if n > 115 else 1) for n in range(1, count)]
    return rising_by([ns * (1 + gaps.get(n, 0)) for n, ns in enumerate(each_ns, 1)])


IN_A_HANG = ((110, 160),)
FAULTLESS = {
    **{
        f"another rate, {rate_hz:g} Hz": (
            rising_by([INTERVAL_NS] * 120 + [round(1e9 / rate_hz)] * 200),
            IN_A_HANG,
        )
        for rate_hz in (100.0, 50.0, 30.0, 23.0, 20.0, 5.0)
    },
    "gaps": (with_gaps(300, {120: 5, 130: 3}), IN_A_HANG),
    "more gaps": (with_gaps(300, {112: 1, 115: 2, 118: 3, 140: 10}), IN_A_HANG),
    # the rate has changed before the gaps: the times cross what the old rate expects
    "gaps at another rate": (with_gaps(300, {120: 5, 130: 3}, 2), IN_A_HANG),
    "more gaps at another rate": (with_gaps(300, {112: 1, 115: 2, 118: 3, 140: 10}, 2), IN_A_HANG),
    "a gap in a long hang": (with_gaps(400, {120: 5}), ((110, 260),)),
    # what has lain in the driver for seconds made a later gap look like a step
    "a gap after a long hang": (with_gaps(900, {700: 2}), ((100, 600), (690, 720))),
}


@pytest.mark.parametrize("case", FAULTLESS)
def test_what_happens_while_the_reader_hangs_is_no_fault_of_the_clock(case: str) -> None:
    """Every time is the camera's own, none is made of when a frame was read."""
    true, hangs = FAULTLESS[case]
    frames, clock, notes, _ = carried([10**9 + t for t in true], hanging(true, *hangs))
    assert [frame.device_time_ns - 10**9 for frame in frames] == true
    assert (clock.rejected, notes) == (0, [])


@pytest.mark.parametrize("step_ms", [130.0, -130.0, -900.0])
@pytest.mark.parametrize("gap", [0, 5])
def test_a_step_behind_a_gap_in_one_hang_is_taken_off_from_where_it_was(step_ms: float, gap: int) -> None:
    """The step belongs to the frame after it, however many waited before."""
    true = with_gaps(300, {120: gap})
    shown = [10**9 + t + round(1e6 * step_ms) * (n >= 135) for n, t in enumerate(true)]
    frames, clock, notes, (step,) = carried(shown, hanging(true, *IN_A_HANG))
    assert [frame.sequence for frame in frames] == list(range(300))
    assert step.time_ns == frames[135].time_ns
    assert [frame.device_time_ns for frame in frames[:135]] == shown[:135]
    assert max(abs(frame.device_time_ns - 10**9 - t) for frame, t in zip(frames, true, strict=True)) < 3e6
    assert clock.rejected == 0
    assert len(notes) == 1
    assert "before frame 135" in notes[0]


def test_a_wrong_time_among_frames_that_were_read_late_is_left_out_alone() -> None:
    true = with_gaps(300, {120: 5})
    shown = [10**9 + t + 27_000_000 * (n == 130) for n, t in enumerate(true)]
    frames, clock, notes, _ = carried(shown, hanging(true, *IN_A_HANG))
    assert [frame.sequence for frame in frames] == [n for n in range(300) if n != 130]
    assert max(abs(frame.device_time_ns - 10**9 - true[frame.sequence]) for frame in frames) == 0
    assert clock.rejected == 1
    assert len(notes) == 1
    assert "1 frame left out from frame 130 on" in notes[0]


def after(count: int, first_ns: int = 10**12, in_real_time: bool = True) -> FrameLine:
    """A line that has taken so many frames, one in 10 ms."""
    line = FrameLine(in_real_time=in_real_time)
    for number in range(count):
        joined_one(line, number, first_ns + number * 10**7, HOST_NS + number * 10**7)
    return line


def joined_one(line: FrameLine, number: int, device_ns: int, host_ns: int) -> tuple[Frame, str]:
    """The frame that the line makes of one whose time is sure, and what is said."""
    line.events.clear()
    (frame,) = line.take(Frame(IMAGE, number, device_ns, host_ns))
    return frame, "; ".join(text for _, text in line.events)


def test_a_clock_that_began_again_is_shifted_and_said_so() -> None:
    line = after(10, in_real_time=False)
    line.restart()
    host_ns = HOST_NS + 9 * 10**7 + 2 * 10**9
    frame, note = joined_one(line, 0, 12345, host_ns)
    assert frame.device_time_ns == 10**12 + 9 * 10**7 + 2 * 10**9
    assert frame.sequence == 9 + 200
    assert "clock restarted" in note
    later, note = joined_one(line, 1, 12345 + 10**7, host_ns + 10**7)
    assert (later.sequence, later.device_time_ns - frame.device_time_ns, note) == (210, 10**7, "")


@pytest.mark.parametrize(("gap", "missing"), [(1, 0), (6, 5)])
def test_a_clock_that_went_on_while_the_camera_was_gone_is_taken_as_it_is(gap: int, missing: int) -> None:
    line = after(10)
    line.restart()
    frame, note = joined_one(line, 0, 10**12 + (9 + gap) * 10**7, HOST_NS + (9 + gap) * 10**7)
    assert (frame.sequence, frame.device_time_ns) == (9 + gap, 10**12 + (9 + gap) * 10**7)
    assert (line.missing, list(line.steps)) == (missing, [])
    assert f"about {missing} of them" in note


def test_a_clock_that_another_one_set_meanwhile_is_shifted_too() -> None:
    """As by a network's clock, decades ahead of the camera's own."""
    line = after(10, 10**9)
    line.restart()
    frame, note = joined_one(line, 0, 1_700_000_000 * 10**9, HOST_NS + 9 * 10**7 + 10**9)
    (step,) = line.steps
    assert (frame.sequence, frame.device_time_ns) == (109, 10**9 + 9 * 10**7 + 10**9)
    assert "clock restarted" in note
    assert (step.time_ns, step.step_ns > 1_600_000_000 * 10**9) == (frame.time_ns, True)


@pytest.mark.parametrize("senseless", [3, 40])
def test_a_camera_that_comes_back_without_times_continues_its_numbers_all_the_same(senseless: int) -> None:
    """Some first frames, or all, show no time; then a clock that began again, or the computer's."""
    line = after(20)
    line.restart()
    shown = [2**62 if n < senseless else 500 + n * 10**7 for n in range(40)]
    read = [Frame(IMAGE, n, shown[n], HOST_NS + 10**9 + n * 10**7) for n in range(40)]
    frames = [frame for one in read for frame in line.take(one)]
    for frame in frames:
        # 0.19 s was the last before it, which is 10**12 + 0.19 s by the camera
        assert frame.device_time_ns - 10**12 == pytest.approx((frame.sequence) * 10**7, abs=1000)
    assert (len(frames), line.rejected) == ((37, 3) if senseless == 3 else (40, 0))
    assert any("opened again" in text for _, text in line.events)


def test_what_waits_when_a_camera_is_lost_is_counted() -> None:
    line = after(20)
    assert line.take(Frame(IMAGE, 20, 7, HOST_NS + 20 * 10**7)) == []
    assert (line.waiting, line.rejected) == (1, 0)
    line.restart()
    assert (line.waiting, line.rejected) == (0, 1)


def test_a_camera_that_is_lost_after_its_first_frame_continues_its_numbers() -> None:
    line = FrameLine()
    first, _ = joined_one(line, 0, 10**12, HOST_NS)
    line.restart()
    again, note = joined_one(line, 0, 7, HOST_NS + 3 * 10**9)
    assert (first.sequence, again.sequence, first.device_time_ns) == (0, 1, 10**12)
    assert again.device_time_ns == first.device_time_ns + 3 * 10**9
    assert "opened again after 3.000 s" in note


def test_the_middle_of_the_exposure_continues_over_a_clock_that_began_again() -> None:
    line = FrameLine(time_shift_ns=-(10**6))
    joined = [joined_one(line, n, 10**12 + n * 10**7, HOST_NS + n * 10**7)[0] for n in range(10)]
    assert [frame.device_time_ns for frame in joined] == [10**12 - 10**6 + n * 10**7 for n in range(10)]
    line.restart()
    again, _ = joined_one(line, 0, 500, HOST_NS + 9 * 10**7 + 10**9)
    assert (again.device_time_ns - joined[-1].device_time_ns, again.sequence) == (10**9, 9 + 100)
    assert joined_one(line, 1, -1, HOST_NS + 10**9)[0].device_time_ns == -1
