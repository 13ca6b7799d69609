"""Values of runs that are made up: balances and half-cycles; and a serial port that somebody speaks at."""

import math
import os
import pty
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from processing.balance import Balance
from processing.deflections import DeflectionUnit
from processing.swing import HalfCycle


def balance_of(unit: DeflectionUnit = DeflectionUnit.RAD, **known: Any) -> Balance:
    """A balance of which only this is known."""
    unknown: dict[str, Any] = dict.fromkeys(Balance.__slots__, math.nan)
    return Balance(**{**unknown, "time_ns": 0, "unit": unit, **known})


def half_cycle(
    index: int, amplitude: float, half_period_s: float = 2.0, *, late_s: float = 0.0, rest: float = 0.0
) -> HalfCycle:
    """A clean one of a regular swing, which turns `late_s` after its time."""
    turn_ns = round(1e9 * (index * half_period_s + late_s))
    return HalfCycle(index, turn_ns, 1e-6, amplitude, 1e-9, half_period_s, 1e-6, rest, 1, 0)


@contextmanager
def speaking_port(says: Callable[[bytes], bytes], every_s: float = 0.05) -> Iterator[str]:
    """The port of a device that says this every so often, by what it has heard since."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(every_s):
            heard = b""
            with suppress(BlockingIOError):
                heard = os.read(master, 4096)
            # which fails while nobody reads
            with suppress(BlockingIOError):
                os.write(master, says(heard))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        thread.join()
        os.close(master)
        os.close(slave)
