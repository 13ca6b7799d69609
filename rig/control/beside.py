"""Darkens beside the program that has the devices: it may be frozen, and then hears nobody."""

import errno
import os
import secrets

from rig.control.lasers import LaserSettings, off_line
from rig.control.protocol import TAG_MAX, encode
from rig.control.settings import ControllerSettings


def darken_beside(laser: LaserSettings, controller: ControllerSettings) -> list[str]:
    """Write "off" to the ports of controller and laser, whoever has them open; returns what failed.

    Waits for nothing, neither for a lock nor for a reply: the reply goes to whoever has the port, who skips
    it. A system on which a port cannot be opened twice says so.
    """
    orders = []
    if laser.kind == "controller" and controller.kind == "serial":
        # two tags: of a line whose first bytes were lost, or that was sent before, the other remains
        first = 1 + secrets.randbelow(TAG_MAX - 1)
        off = b"".join(b"\n" + encode(tag, "LASer:STATe OFF") for tag in (first, first + 1))
        orders.append((controller.port, off))
    if (line := off_line(laser)) is not None:
        orders.append((laser.port, line))
    problems = []
    for port, data in orders:
        try:
            _write(port, data)
        except OSError as error:
            problems.append(f"{port}: cannot be switched off: {error.strerror or error}")
    return problems


def _write(port: str, data: bytes) -> None:
    descriptor = os.open(port, os.O_WRONLY | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_NONBLOCK", 0))
    try:
        if os.write(descriptor, data) < len(data):
            raise OSError(errno.EAGAIN, "the port took only part of the command")
    finally:
        os.close(descriptor)
