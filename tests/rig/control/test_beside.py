"""LIGHT OFF that is written to a port beside the program that has it: whether all of it was taken."""

import os
import pty
import re
import select
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Event

import pytest

from rig.control import ControllerSettings, LaserSettings, darken_directly, presses

pytestmark = pytest.mark.skipif(os.name != "posix", reason="a port is opened once there")
PIECE = b"x" * 37


@contextmanager
def port() -> Iterator[tuple[str, int]]:
    """A port, and the end at which nobody reads."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave), master
    os.close(master)
    os.close(slave)


def filled(name: str, most: int) -> int:
    """Write so many bytes, or as many as are taken; returns their number."""
    descriptor, count = os.open(name, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK), 0
    with suppress(BlockingIOError):
        while count < most:
            count += os.write(descriptor, PIECE[: most - count])
    os.close(descriptor)
    return count


@pytest.mark.parametrize("room", [0, 5, 15, 30, 45, 1_000_000])
def test_an_order_of_which_only_a_part_was_taken_is_said(room: int) -> None:
    with port() as (name, _):
        holds = filled(name, 1_000_000)
    with port() as (name, master):
        filled(name, max(holds - room, 0))
        laser = LaserSettings(kind="controller", max_power_w=0.001, power_w=0.0005)
        problems = darken_directly(laser, ControllerSettings(kind="serial", port=name))
        taken = b""
        while select.select([master], [], [], 0.1)[0]:
            taken += os.read(master, 65536)
    # each order ends with a checksum and a line's end
    whole = len(re.findall(rb"#\d+ LASer:STATe OFF\*[0-9A-F]{4}\n", taken)) == 2
    # how much room there is the system decides anew each time
    assert bool(problems) is not whole
    assert whole or room < 1000


def test_a_port_that_hangs_keeps_no_other_from_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    goes_on = Event()
    usual = os.open

    def hangs(name: str, *flags: int) -> int:
        assert name != "/dev/ttyHangs" or goes_on.wait(60.0)
        return usual(name, *flags)

    with port() as (name, master):
        monkeypatch.setattr(presses.os, "open", hangs)
        monkeypatch.setattr(presses, "off_bytes", lambda _: b"OFF")
        controller = ControllerSettings(kind="serial", port="/dev/ttyHangs")
        laser = LaserSettings(kind="controller", max_power_w=0.001, power_w=0.0005).model_copy(
            update={"port": name}
        )
        problems = darken_directly(laser, controller)
        assert select.select([master], [], [], 10.0)[0]
        assert os.read(master, 100) == b"OFF"
        goes_on.set()
    assert problems == ["/dev/ttyHangs: cannot be switched off: the port hangs"]
