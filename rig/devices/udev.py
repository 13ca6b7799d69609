"""`rig doctor --install-udev`: Linux's rules by which users may open the rig's devices."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from acquisition import atomic_write
from acquisition.cameras.usb3vision.link import UDEV_RULE
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
    """The text of the file: one rule for each kind of device that a driver here opens by itself.

    Video4Linux's nodes have rules of systemd's own, and cameras on a network have no node.
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
    """The one command that installs the rules, for who is not root."""
    return shlex.join(["sudo", sys.executable, "-m", "rig", "doctor", "--install-udev"])


def install_rules(folder: Path = RULES_FOLDER) -> tuple[Path, str]:
    """Write the file, in place of one of an earlier version; returns it and what is to be done then.

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
    """Whether udev's daemon has read the rules again; there is none in a container."""
    udevadm = shutil.which("udevadm")
    if udevadm is None or os.geteuid() != 0:
        return False
    done = subprocess.run([udevadm, "control", "--reload"], capture_output=True, timeout=30, check=False)
    return done.returncode == 0
