"""Starts the executable of the viewer, bound to 127.0.0.1.

The executable inside the package is started directly: the `rerun` command is a Python wrapper, and the viewer
would continue to run after the wrapper is ended. By default the viewer listens on all interfaces and sends
usage data; both are switched off here. The page, which has settings of its own in the browser, sends them.
"""

import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import rerun_cli

from rig.terminal import LOOPBACK, own_group


def program() -> Path:
    """The viewer's executable inside its package."""
    folder = Path(rerun_cli.__file__).parent
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    if sys.platform == "darwin" and bundled.exists():
        return bundled
    return folder / ("rerun.exe" if sys.platform == "win32" else "rerun")


def quiet_environment() -> dict[str, str]:
    """Environment variables with which the program sends no usage data.

    Usage data can be switched off only by a command of the program, which stores this in the user's settings.
    On Linux the program is given a settings folder of its own, so that the user's settings do not change.
    """
    environment = {**os.environ, "RERUN_APP_ONLY": "true"}
    if sys.platform.startswith("linux"):
        settings = Path(tempfile.gettempdir()) / f"rerun-settings-{os.getuid()}"
        settings.mkdir(mode=0o700, exist_ok=True)
        made = settings.lstat()
        if not stat.S_ISDIR(made.st_mode) or made.st_uid != os.getuid() or made.st_mode & 0o077:
            # in a folder for all users anyone could have made it before, and read or change what is in it
            settings = Path(tempfile.mkdtemp(prefix="rerun-settings-"))
        environment["XDG_CONFIG_HOME"] = str(settings)
    subprocess.run(
        [program(), "analytics", "disable"], check=True, capture_output=True, timeout=60, env=environment
    )
    return environment


def start_program(
    *arguments: str, environment: dict[str, str] | None = None, alone: bool = True
) -> subprocess.Popen[bytes]:
    """Start the program on 127.0.0.1, without output; `alone`: it outlives this one's process group."""
    return subprocess.Popen(
        [program(), "--bind", LOOPBACK, *arguments],
        env=environment if environment is not None else quiet_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        **(own_group() if alone else {}),
    )
