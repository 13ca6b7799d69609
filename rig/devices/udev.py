"""Cameras at the computer: udev rules for access to devices, features as lines, the newest frames."""

import os
import shlex
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path

from acquisition import atomic_write
from acquisition.camera import Camera, Frame
from acquisition.cameras.usb3vision.link import UDEV_RULE
from acquisition.cameras.usb3vision.node_map import READ_WRITE, WRITE_ONLY, FeatureReading
from acquisition.frames.guard import FrameChecks
from acquisition.frames.queue import BoundedQueue
from processing.errors import ConfigurationError, DeviceError
from rig.control import udev_board, udev_matches

RULES_FOLDER = Path("/etc/udev/rules.d")
_FILE = "70-optical-pendulum-rig.rules"
_ACCESS = 'MODE="0660", TAG+="uaccess"'
_HEAD = """\
# Devices of an optical pendulum rig, written by rig doctor --install-udev: whoever sits at the computer may
# use them, and so may a group, for services and remote users.
# The number must stay below 73, where systemd grants what the tag "uaccess" asks for."""


def udev_rules() -> str:
    """The text of the file, with a rule for each kind of device that a driver of this program opens itself.

    Video4Linux's nodes have systemd's own rules, and cameras on a network have no node.
    """
    lines = [
        _HEAD,
        "# USB3 Vision cameras of every make, also for pylon and libaravis",
        f'{UDEV_RULE}, GROUP="plugdev", {_ACCESS}',
    ]
    for kind, match in udev_matches().items():
        group = "dialout" if "tty" in match else "plugdev"
        lines += [f"# {kind}", f'{match}, GROUP="{group}", {_ACCESS}']
    lines += [
        "# ModemManager writes to every new serial port: not to the board that switches the laser",
        f'{udev_board()}, ENV{{ID_MM_DEVICE_IGNORE}}="1"',
    ]
    return "\n".join(lines) + "\n"


def as_root() -> str:
    """The command by which a user who is not root installs the rules."""
    return shlex.join(["sudo", sys.executable, "-m", "rig", "doctor", "--install-udev"])


def install_rules(folder: Path = RULES_FOLDER) -> tuple[Path, str]:
    """Write the file, replacing that of an earlier version; returns its path and the next instruction.

    Raises
    ------
    ConfigurationError
        This system has no udev, or no such folder.
    DeviceError
        Only root may write there, or it cannot be written.
    """
    if sys.platform != "linux":
        raise ConfigurationError("--install-udev: udev is a part of Linux; this system needs no such rules")
    if folder == RULES_FOLDER and not folder.is_dir():
        raise ConfigurationError(f"{folder}: no such folder; this system has no udev, and needs no rules")
    path = folder / _FILE
    try:
        atomic_write.replace(path, udev_rules().encode(), mode=0o644)
    except PermissionError:
        raise DeviceError(f"{path}: only root may write it: {as_root()}") from None
    except OSError as error:
        raise DeviceError(f"{path}: cannot be written: {error.strerror or error}") from None
    again = "plug the devices in again"
    if folder == RULES_FOLDER and not _reloaded():
        again = f"sudo udevadm control --reload, then {again}"
    return path, again


def _reloaded() -> bool:
    """Make udev's daemon read the rules again; False if that fails, as in a container without one."""
    udevadm = shutil.which("udevadm")
    if udevadm is None or os.geteuid() != 0:
        return False
    done = subprocess.run([udevadm, "control", "--reload"], capture_output=True, timeout=30, check=False)
    return done.returncode == 0


_NO_LIMIT = 2.0**62
"""A larger limit means none: cameras report the type's largest number for a feature without a limit."""


def feature_lines(readings: Iterable[FeatureReading]) -> Iterator[str]:
    """One line for each feature: name, value with its unit, range or choices, access."""
    shown = [(reading.name, _value(reading), _remark(reading)) for reading in readings]
    names = max((len(name) for name, _, _ in shown), default=0)
    values = min(max((len(value) for _, value, _ in shown), default=0), 24)
    for name, value, remark in shown:
        yield f"{name:<{names}}  {value:<{values}}  {remark}".rstrip()


def _value(reading: FeatureReading) -> str:
    value = reading.value
    if reading.kind == "Command":
        return "command"
    if value is None:
        return "-"
    if isinstance(value, bytes):
        return value.hex(" ") or "empty"
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    return f"{text} {reading.unit}".strip()


def _remark(reading: FeatureReading) -> str:
    if reading.problem:
        return reading.problem
    if reading.kind == "Command":
        return "" if reading.access == WRITE_ONLY else reading.access
    if reading.access != READ_WRITE:
        return reading.access
    if reading.choices:
        return "one of " + ", ".join(reading.choices)
    low, high = reading.minimum, reading.maximum
    if isinstance(reading.value, bool | str | bytes) or low is None or high is None:
        return ""
    if abs(low) >= _NO_LIMIT and abs(high) >= _NO_LIMIT:
        return ""
    return f"{low:.9g} to {high:.9g} {reading.unit}".strip()


_LOOK_S = 0.2
_TIMEOUT_S = 5.0


def watch_latest(
    camera: Camera,
    at_least: int,
    end_s: float,
    interval_s: float = _LOOK_S,
    on_frame: Callable[[Frame], object] = lambda _: None,
) -> Generator[list[Frame]]:
    """Yield blocks of `at_least` frames, at most one per `interval_s`; older frames are dropped.

    The camera must be configured and stopped. It runs until the monotonic time `end_s`, but for one block
    at least; until its source ends; or until the caller stops iterating. It is then stopped. Errors of the
    camera, and frames that no camera may deliver, are raised here. `on_frame` is called with every frame,
    dropped ones too, in the thread that reads them.
    """
    errors: list[Exception] = []
    delivered, queue = FrameChecks(), BoundedQueue[Frame](at_least, "latest")

    def acquire() -> None:
        try:
            while (frame := camera.read(_TIMEOUT_S)) is not None:
                checked = delivered.check(frame)
                on_frame(checked)
                queue.put(checked)
                if ended.is_set():
                    break
        except Exception as error:
            errors.append(error)
        finally:
            queue.close()

    ended = threading.Event()
    camera.start()
    thread = threading.Thread(target=acquire, name="camera", daemon=True)
    thread.start()
    try:
        while not queue.drained:
            frames: list[Frame] = []
            while len(frames) < at_least and not queue.drained:
                frames += queue.take(at_least - len(frames), 0.1)
            if frames:
                yield frames
            if time.monotonic() >= end_s:
                break
            time.sleep(interval_s)
        if errors:
            raise errors[0]
    finally:
        ended.set()
        queue.close()
        camera.stop()
        thread.join(_TIMEOUT_S)
