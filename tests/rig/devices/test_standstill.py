"""A program whose computer slept believes no time that follows; one that only stood still goes on."""

from collections.abc import Sequence

import pytest

from processing.errors import DeviceError
from rig.devices.frame_stream import SleepWatch, read_sleep_ns

S = 10**9


def watch(readings: Sequence[tuple[float, float]]) -> SleepWatch:
    """One that reads these clocks, in s: without and with sleep."""
    slept_ns = [round((with_sleep_s - awake_s) * S) for awake_s, with_sleep_s in readings]
    return SleepWatch(lambda: slept_ns.pop(0))


def test_a_program_that_stood_still_goes_on() -> None:
    watch([(0, 0), (12.75, 12.75)]).raise_if_slept()


def test_after_a_sleep_no_time_is_believed() -> None:
    with pytest.raises(DeviceError, match="slept for 600 s, in which its clock stood"):
        watch([(100, 100), (100.02, 700.02)]).raise_if_slept()


def test_the_clocks_agree_while_nothing_sleeps() -> None:
    assert abs(read_sleep_ns() - read_sleep_ns()) < S
