"""Starts the executable of the viewer, bound to 127.0.0.1.

The executable inside the package is started directly: the `rerun` command is a Python wrapper, and the viewer
would continue to run after the wrapper is ended. By default the viewer listens on all interfaces and sends
usage data; both are switched off here.
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


def display_missing() -> str:
    """Reason for which no window can be opened here; empty if one can be."""
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return (
            "no window was opened: there is no screen here (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            "use --view web, or open the .rrd file on another machine"
        )
    return ""


def open_window(url: str, port: int) -> subprocess.Popen[bytes]:
    """Open a window that shows a live stream and stays after the run. It accepts commands on `port`."""
    return start_program("--port", str(port), "--hide-welcome-screen", "--connect", url)


def start_program(
    *arguments: str, environment: dict[str, str] | None = None, host: str = LOOPBACK
) -> subprocess.Popen[bytes]:
    """Start the program on a loopback address, without output and without Ctrl-C from the terminal."""
    return subprocess.Popen(
        [program(), "--bind", host, *arguments],
        env=environment if environment is not None else quiet_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        **own_group(),
    )
