"""LIGHT OFF by a program that does not have the devices: a file of presses, and a write to the ports."""

import datetime
import errno
import hashlib
import os
import secrets
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ValidationError

from acquisition import atomic_write
from processing.errors import DeviceError
from rig.control.device_thread import run_in_thread
from rig.control.lasers import LaserSettings, off_bytes
from rig.control.protocol import TAG_MAX, encode
from rig.control.settings import ControllerSettings

_MAX_FILE_BYTES = 4096
_MAX_WRITE_S = 0.4
"""Longest wait until the ports have taken the command that switches the light off."""


@dataclass(frozen=True, slots=True)
class Press:
    """The newest press of LIGHT OFF."""

    mark: str
    """Mark that identifies the press; empty if there was none yet."""
    why: str


class _PressFile(BaseModel, frozen=True, extra="forbid"):
    number: int
    who: str
    utc: str


class Presses:
    """The file of one rig's presses. It is never locked, so that no program can block a press."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def press(self, who: str) -> None:
        """Note a press at the place `who`; raises DeviceError where not even the file's time can be set.

        A full disk takes no new content, but still the time of an existing file, or an empty file.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            utc = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
            content = _PressFile(number=self._number() + 1, who=who, utc=utc)
            atomic_write.replace(self.path, content.model_dump_json().encode())
        except OSError as error:
            try:
                self.touch()
            except OSError:
                raise DeviceError(f"{self.path}: cannot be written: {error.strerror or error}") from None

    def touch(self) -> None:
        """Note a press by the file's time only; raises OSError where that is impossible."""
        self.path.touch()
        with suppress(OSError):
            atomic_write.sync_folder(self.path.parent)

    def newest(self) -> Press:
        """The newest press. Raises DeviceError for a file that cannot be read, as a press is then unknown."""
        try:
            descriptor = os.open(self.path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
            try:
                content, stat = os.read(descriptor, _MAX_FILE_BYTES), os.fstat(descriptor)
            finally:
                os.close(descriptor)
        except FileNotFoundError:
            return Press("", f"{self.path} is gone, so whether LIGHT OFF was pressed is unknown")
        except OSError as error:
            raise DeviceError(
                f"{self.path}: cannot be read: {error.strerror or error}; "
                "whether LIGHT OFF was pressed is unknown"
            ) from None
        mark = f"{stat.st_mtime_ns} {hashlib.sha256(content).hexdigest()[:16]}"
        try:
            return Press(mark, f"LIGHT OFF was pressed at {_PressFile.model_validate_json(content).who}")
        except ValidationError:
            return Press(mark, "LIGHT OFF was pressed, or a trip could not be written")

    def _number(self) -> int:
        with suppress(OSError, ValidationError):
            return _PressFile.model_validate_json(self.path.read_bytes()).number
        return 0


def darken_directly(laser: LaserSettings, controller: ControllerSettings) -> list[str]:
    """Write "off" to the ports of controller and laser, in any program; returns failures.

    It waits neither for a lock nor for a reply: the program that has the port receives the reply, and skips
    it. A port that hangs delays no other port. A system on which a port cannot be opened twice is a failure.
    """
    commands = []
    if laser.kind == "controller" and controller.kind == "serial":
        # sent with two tags, in case that the first line lost its first bytes, or its tag was used before
        first_tag = 1 + secrets.randbelow(TAG_MAX - 1)
        lines = (b"\n" + encode(tag, "LASer:STATe OFF") for tag in (first_tag, first_tag + 1))
        commands.append((controller.port, b"".join(lines)))
    if (off := off_bytes(laser)) is not None:
        commands.append((laser.port, off))
    writes = [(port, run_in_thread(_write, port, command)) for port, command in commands]
    deadline_s = time.monotonic() + _MAX_WRITE_S
    problems = []
    for port, write in writes:
        try:
            write.result(max(deadline_s - time.monotonic(), 0.0))
        except TimeoutError:
            problems.append(f"{port}: cannot be switched off: the port hangs")
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
