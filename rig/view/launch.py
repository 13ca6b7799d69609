"""Starts `rig view` on a record that is about to be written, as processes that only read it.

Nothing of theirs can end, slow or darken what measures: they get no more than the record's path.
"""

import os
import signal
import subprocess
import sys
import urllib.parse
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from processing.errors import ConfigurationError, RecordError
from rig.presentation import say
from rig.terminal import LOOPBACK, free_port, start_python
from rig.view.values import LayoutName, Mode

_SHOW_END_S, _WRITE_END_S = 10.0, 30.0
"""So long a window or page, and a Rerun file, may take for what is left of their record of a run."""
_PORT, _WEB_PORT = 9876, 9090


class RunningView:
    """A window or page, a Rerun file, both or none; a context manager.

    Parameters
    ----------
    record
        Need not be there yet.
    mode
        How it is shown; the address of a page is said.
    rrd
        Rerun file to write, or None. Must not exist yet.
    layout
        The layout that opens first.
    """

    def __init__(self, record: Path, mode: Mode, rrd: Path | None, layout: LayoutName) -> None:
        if rrd is not None and rrd.exists():
            raise ConfigurationError(f"the Rerun file {rrd} exists already; choose another name")
        self.record, self.rrd = record, rrd
        self._writing = None if rrd is None else self._started("--rrd", str(rrd), "--layout", layout)
        self._showing: subprocess.Popen[Any] | None = None
        if mode == "spawn" and (missing := no_window()):
            say(missing)
        elif mode != "none":
            port, web_port = ports_of_view()
            ports = ("--ports", str(port), str(web_port))
            shown = "window" if mode == "spawn" else "web"
            self._showing = self._started("--view", shown, "--layout", layout, *ports)
            if mode == "web":
                say(f"live view: {page_address(port, web_port)}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_error: object) -> None:
        problem = self.close()
        if problem and kind is None:
            raise RecordError(problem)

    @property
    def pids(self) -> tuple[int, ...]:
        """Numbers of the processes that were started."""
        return tuple(one.pid for one in (self._writing, self._showing) if one is not None)

    def close(self, *, patient: bool = False) -> str:
        """Let the processes draw what is left, after the record is closed; what the Rerun file lacks, if
        anything. `patient`: it is waited for as long as it takes.
        """
        self._ended(self._showing, _SHOW_END_S)
        said = self._ended(self._writing, None if patient else _WRITE_END_S)
        if said is None:
            return ""
        return said or f"the Rerun file {self.rrd} is not whole: its writer was ended"

    def _started(self, *words: str) -> "subprocess.Popen[Any]":
        null = subprocess.DEVNULL
        # it ends by itself with the record, so that the Rerun file of a run that was killed is whole
        program = ("-m", "rig", "view", str(self.record), "--follow")
        return start_python(*program, *words, stdin=null, stdout=null, stderr=subprocess.PIPE)

    def _ended(self, process: "subprocess.Popen[Any] | None", limit_s: float | None) -> str | None:
        """Wait for the end of a process; None where all is well, else what it said last."""
        if process is None:
            return None
        if not self.record.exists():
            process.terminate()
        try:
            _, said = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            process.kill()
            _, said = process.communicate()
        if os.name == "posix":
            # a page's server that a killed view has left
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        if process.returncode == 0 or not self.record.exists():
            return None
        lines = said.decode(errors="replace").strip().splitlines()
        return lines[-1].removeprefix("rig: ") if lines else ""


def ports_of_view() -> tuple[int, int]:
    """Free ports of 127.0.0.1 for the stream and for the page."""
    return free_port(_PORT), free_port(_WEB_PORT)


def page_address(port: int, web_port: int) -> str:
    """Address of the page for a browser."""
    stream = urllib.parse.quote(f"rerun+http://{LOOPBACK}:{port}/proxy", safe="")
    return f"http://{LOOPBACK}:{web_port}/?url={stream}"


def no_window() -> str:
    """Reason for which no window can be opened here; empty if one can be."""
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return (
            "no window was opened: there is no screen here (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            "use --view web, or open the .rrd file on another machine"
        )
    return ""
