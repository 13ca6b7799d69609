"""The view of a record while it is written, by a process of its own."""

import os
import signal
import subprocess
import sys
import urllib.parse
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from rig.interruption import LOOPBACK, free_port, start_python
from rig.terminal import say

ShowMode = Literal["spawn", "web"]
"""Ways to show a view: in a window, or as a page in a browser."""
Mode = Literal["none", ShowMode]
"""How a view is shown, if at all."""
LayoutName = Literal["balancing", "measuring", "analysing"]
_MAX_SHOW_END_S = 10.0
"""Longest time in which a window or page must plot the rest of a run's record."""
_PORT, _WEB_PORT = 9876, 9090


class RunningView:
    """The process that shows a record in a window or a page; with the mode `none` there is no process.

    `record` need not exist yet. The address of a page is printed.
    """

    def __init__(self, record: Path, mode: Mode, layout: LayoutName) -> None:
        self._record = record
        self._process: subprocess.Popen[Any] | None = None
        if mode == "spawn" and (reason := no_window()):
            say(reason)
        elif mode != "none":
            port, web_port = ports_of_view()
            null, option = subprocess.DEVNULL, "window" if mode == "spawn" else "web"
            # the process ends by itself with the record
            self._process = start_python(
                *("-m", "rig", "view", str(record), "--follow", "--view", option),
                *("--layout", layout, "--ports", str(port), str(web_port)),
                stdin=null,
                stdout=null,
                stderr=null,
            )
            if mode == "web":
                say(f"live view: {page_address(port, web_port)}")

    def close(self) -> None:
        """Wait, after the record is closed, until the process has plotted the rest of it."""
        process = self._process
        if process is None:
            return
        if not self._record.exists():
            process.terminate()
        try:
            process.wait(_MAX_SHOW_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if os.name == "posix":
            # end the page's server that a killed view may have left
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def ports_of_view() -> tuple[int, int]:
    """Free ports of 127.0.0.1 for the stream and for the page."""
    return free_port(_PORT), free_port(_WEB_PORT)


def page_address(port: int, web_port: int) -> str:
    """Address of the page for a browser."""
    stream = urllib.parse.quote(f"rerun+http://{LOOPBACK}:{port}/proxy", safe="")
    return f"http://{LOOPBACK}:{web_port}/?url={stream}"


def no_window() -> str:
    """Reason for which no window can be opened here; empty if one can be."""
    has_screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not has_screen:
        return (
            "no window was opened: there is no screen here (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            "use --view web, or open the .rrd file on another machine"
        )
    return ""
