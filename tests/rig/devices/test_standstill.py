"""A program whose computer slept believes no time that follows; one that only stood still goes on."""

from collections.abc import Sequence

import pytest

from processing.errors import DeviceError
from rig.devices.frame_stream import AwakeTime, SleepWatch, read_awake

S = 10**9


def watch(readings: Sequence[tuple[float, float]]) -> SleepWatch:
    """One that reads these clocks, in s."""
    left = [AwakeTime(round(awake_s * S), round(with_sleep_s * S)) for awake_s, with_sleep_s in readings]
    return SleepWatch(lambda: left.pop(0))


def test_a_program_that_stood_still_goes_on() -> None:
    watch([(0, 0), (12.75, 12.75)]).raise_if_slept()


def test_after_a_sleep_no_time_is_believed() -> None:
    with pytest.raises(DeviceError, match="slept for 600 s, in which its clock stood"):
        watch([(100, 100), (100.02, 700.02)]).raise_if_slept()


def test_the_clocks_agree_while_nothing_sleeps() -> None:
    first, second = read_awake(), read_awake()
    slept_ns = (second.with_sleep_ns - first.with_sleep_ns) - (second.awake_ns - first.awake_ns)
    assert abs(slept_ns) < S
