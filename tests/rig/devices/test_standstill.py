"""A program that stood still says so, and one whose computer slept believes no time that follows."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence

import pytest

from processing.errors import DeviceError
from rig.devices.frame_stream import AwakeTime, Standstill, read_awake

S = 10**9


def standstill(readings: Sequence[tuple[float, float]]) -> tuple[Standstill, list[str]]:
    """One that reads these clocks, in s, and what it tells."""
    told: list[str] = []
    left = [AwakeTime(round(awake_s * S), round(with_sleep_s * S)) for awake_s, with_sleep_s in readings]
    return Standstill(told.append, lambda: left.pop(0)), told


def test_what_is_late_is_told_once() -> None:
    found, told = standstill([(0, 0), (0.3, 0.3), (12.75, 12.75), (13, 13)])
    for _ in range(3):
        found.look()
    (said,) = told
    assert said.startswith("the program stood still for 12.2 s")


def test_a_busy_computer_is_no_standstill() -> None:
    found, told = standstill([(0, 0), (1.9, 1.9)])
    found.look()
    found_2, told_2 = standstill([(5, 5), (5.3, 5.3)])
    found_2.raise_if_slept()
    assert not told
    assert not told_2


def test_after_a_sleep_no_time_is_believed() -> None:
    found, _ = standstill([(100, 100), (100.02, 700.02)])
    with pytest.raises(DeviceError, match="slept for 600 s, in which its clock stood"):
        found.raise_if_slept()


def test_the_clocks_agree_while_nothing_sleeps() -> None:
    first, second = read_awake(), read_awake()
    slept_ns = (second.with_sleep_ns - first.with_sleep_ns) - (second.awake_ns - first.awake_ns)
    assert abs(slept_ns) < S


PROGRAM = """
import threading
from rig.devices.frame_stream import Standstill
told = threading.Event()
standstill = Standstill(lambda text: (print(text, flush=True), told.set()))
standstill.begin()
print("begun", flush=True)
told.wait(60)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="has no such signals")
def test_a_program_that_was_stopped_says_for_how_long() -> None:
    program = subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    with program, program.stdout:
        assert program.stdout.readline() == "begun\n"
        os.kill(program.pid, signal.SIGSTOP)
        # what is stopped does nothing that could be waited for
        time.sleep(3.0)
        os.kill(program.pid, signal.SIGCONT)
        assert "the program stood still for" in program.stdout.readline()
