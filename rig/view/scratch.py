"""Views of a run, and of programs that do not measure and write a scratch record for `rig view` instead."""

import math
import os
import signal
import subprocess
import sys
import tempfile
import urllib.parse
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from acquisition.camera import Frame
from acquisition.record import pixels_beside
from acquisition.record.events import Event, EventKind
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import ConfigurationError, RecordError
from processing.spot import Spot, SpotFlag
from rig.instrument import Block
from rig.interruption import LOOPBACK, free_port, start_python
from rig.terminal import say

ShowMode = Literal["spawn", "web"]
"""In a window, or in a browser."""
Mode = Literal["none", ShowMode]
"""How a view is shown, if at all."""
LayoutName = Literal["balancing", "measuring", "analysing"]
_MAX_SHOW_END_S, _MAX_WRITE_END_S = 10.0, 30.0
"""Longest time in which a window or page, and a Rerun file, must draw the rest of a run's record."""
_PORT, _WEB_PORT = 9876, 9090


class RunningView:
    """The processes that show a record: a window or page, a Rerun file, both or none.

    Parameters
    ----------
    record
        Path of the record, which need not exist yet.
    mode
        How the record is shown; the address of a page is printed.
    rrd
        Rerun file to write, or None. Must not exist yet.
    layout
        The layout that opens first.
    """

    def __init__(self, record: Path, mode: Mode, rrd: Path | None, layout: LayoutName) -> None:
        if rrd is not None and rrd.exists():
            raise ConfigurationError(f"the Rerun file {rrd} exists already; choose another name")
        self.record, self.rrd = record, rrd
        self._file_process = None if rrd is None else self._start("--rrd", str(rrd), "--layout", layout)
        self._viewer_process: subprocess.Popen[Any] | None = None
        if mode == "spawn" and (reason := no_window()):
            say(reason)
        elif mode != "none":
            port, web_port = ports_of_view()
            ports = ("--ports", str(port), str(web_port))
            shown = "window" if mode == "spawn" else "web"
            self._viewer_process = self._start("--view", shown, "--layout", layout, *ports)
            if mode == "web":
                say(f"live view: {page_address(port, web_port)}")

    def close(self, *, unlimited: bool = False) -> str:
        """Wait, after the record is closed, until the processes have drawn the rest of it.

        Returns the problem of the Rerun file, empty without one. If `unlimited`, the file may take any time.
        """
        self._wait_for_end(self._viewer_process, _MAX_SHOW_END_S)
        last_line = self._wait_for_end(self._file_process, None if unlimited else _MAX_WRITE_END_S)
        if last_line is None:
            return ""
        return last_line or f"the Rerun file {self.rrd} is not whole: its writer was ended"

    def _start(self, *words: str) -> "subprocess.Popen[Any]":
        null = subprocess.DEVNULL
        # the process ends by itself with the record, so that even the Rerun file of a killed run is whole
        program = ("-m", "rig", "view", str(self.record), "--follow")
        return start_python(*program, *words, stdin=null, stdout=null, stderr=subprocess.PIPE)

    def _wait_for_end(self, process: "subprocess.Popen[Any] | None", limit_s: float | None) -> str | None:
        """Wait for the end of a process; returns None if it succeeded, else its last line on stderr."""
        if process is None:
            return None
        if not self.record.exists():
            process.terminate()
        try:
            _, errors = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            process.kill()
            _, errors = process.communicate()
        if os.name == "posix":
            # end the page's server that a killed view may have left
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        if process.returncode == 0 or not self.record.exists():
            return None
        lines = errors.decode(errors="replace").strip().splitlines()
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


_PICTURE_INTERVAL_NS = 300_000_000
_LOST = Spot._make([*[math.nan] * 10, int(SpotFlag.LOST)])


class ScratchView:
    """Shows values by a scratch record, which is removed at the end; a context manager with the title `name`.

    At the end RecordError is raised if a Rerun file is not whole. Beyond `max_bytes` the record is replaced
    by a new one, with which the view continues. Deflections are in `unit`.
    """

    def __init__(
        self,
        name: str,
        mode: Mode,
        rrd: Path | None,
        layout: LayoutName,
        unit: DeflectionUnit,
        max_bytes: float = 256 * 1024 * 1024,
    ) -> None:
        self._unit, self._most_bytes = unit, max_bytes
        self._folder = tempfile.TemporaryDirectory(prefix="rig-view-")
        self._path = Path(self._folder.name) / f"{name}.mcap"
        self._header: Mapping[str, Any] = {}
        self._writer: RecordWriter | None = None
        self._failed = False
        self._sequence = self._last_ns = self._picture_due_ns = 0
        self._view = RunningView(self._path, mode, rrd, layout)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_error: object) -> None:
        self._end()
        problem = self._view.close(unlimited=True)
        self._folder.cleanup()
        if problem and kind is None:
            raise RecordError(problem)

    def begin(self, time_ns: int, **header: Any) -> None:
        """Begin the record; `header` holds `epoch_offset_ns`, `metadata` and `attachments` of `RecordWriter`.

        Times may be some seconds below 0: a turning point may lie before the first frame.
        """
        self._header = header
        self._last_ns = self._picture_due_ns = time_ns
        self._writer = RecordWriter(self._path, deflection_unit=self._unit, **header)

    def block(self, block: Block, frames: Sequence[Frame], shift_ns: int) -> None:
        """Write the results of frames, and a picture at intervals; `shift_ns` is subtracted from times."""
        deflections = replace(block.deflections, times_ns=block.deflections.times_ns - shift_ns)
        moved = block._replace(
            deflections=deflections,
            swings=[replace(one, turn_time_ns=one.turn_time_ns - shift_ns) for one in block.swings],
            balances=[replace(one, time_ns=one.time_ns - shift_ns) for one in block.balances],
        )
        self._write_block(
            moved, [frame._replace(device_time_ns=frame.time_ns - shift_ns) for frame in frames]
        )

    def _write_block(self, block: Block, frames: Sequence[Frame] = ()) -> None:
        times_ns = block.deflections.times_ns.tolist()
        numbers = range(self._sequence, self._sequence + len(times_ns))
        self._sequence += len(times_ns)
        self._last_ns = times_ns[-1] if times_ns else self._last_ns

        def write(writer: RecordWriter) -> None:
            block.write(writer, numbers, times_ns, times_ns)
            if frames and frames[-1].time_ns >= self._picture_due_ns:
                self._picture_due_ns = frames[-1].time_ns + _PICTURE_INTERVAL_NS
                writer.write_preview(frames[-1]._replace(sequence=numbers[-1]))
            writer.flush_if_due()

        self._write(write)

    def event(self, event: Event) -> None:
        """Write an event: a line of the log, or the advice on the last balance."""
        self._write(lambda writer: writer.write_event(event.time_ns, event.kind, event.text))

    def jump(self, time_ns: int, text: str) -> None:
        """Continue at a later time; curves are interrupted there, and `text` is logged."""
        unknown = np.full(1, math.nan)
        nowhere = Deflections(np.array([time_ns]), unknown, unknown, unknown, unknown, self._unit)
        self._write_block(Block([_LOST], nowhere, [], []))
        self.event(Event(time_ns, EventKind.START, text))

    def _write(self, write: Callable[[RecordWriter], None]) -> None:
        """Write into the record, unless it has not begun or writing has failed."""
        if self._writer is None or self._failed:
            return
        try:
            if self._writer.bytes_written > self._most_bytes:
                self._replace_record(self._writer)
            write(self._writer)
        except (OSError, RecordError) as error:
            # an error ends only the view
            self._failed = True
            say(f"the view ends: {error}")

    def _replace_record(self, full: RecordWriter) -> None:
        """Begin a new record, as after a rejected start."""
        full.write_event(self._last_ns, EventKind.REJECTED, "restarted")
        self._end()
        old_path = self._path.with_suffix(".old")
        # the old file is removed last: otherwise the new file could get its inode, by which the view tells
        # them apart
        self._path.rename(old_path)
        pixels_beside(self._path).unlink(missing_ok=True)
        self.begin(self._last_ns, **self._header)
        old_path.unlink()

    def _end(self) -> None:
        if self._writer is not None:
            with suppress(RecordError):
                self._writer.close()
