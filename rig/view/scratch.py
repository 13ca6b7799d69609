"""The view of a program that looks without measuring: a record in a scratch folder, and `rig view` on it."""

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
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from acquisition.camera import Frame
from acquisition.record import pixels_beside
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import REFERENCE, RecordedReference
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import ConfigurationError, RecordError
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycle
from rig.instrument import Block
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


_PICTURE_NS = 300_000_000
_LOST = Spot._make([*[math.nan] * 10, int(SpotFlag.LOST)])


class ScratchHead(NamedTuple):
    """What a scratch record begins with, as `RecordWriter` takes it."""

    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, bytes]
    unit: DeflectionUnit


class ScratchView:
    """Shows what is written into a record of its own, which is removed at the end.

    A context manager; at its end RecordError is raised where a Rerun file is not whole. `name` is the title.
    Beyond `most_bytes` the record is replaced by another one, with which the view goes on.
    """

    def __init__(
        self,
        name: str,
        mode: Mode,
        rrd: Path | None,
        layout: LayoutName,
        most_bytes: float = 256 * 1024 * 1024,
    ) -> None:
        self._most_bytes = most_bytes
        self._folder = tempfile.TemporaryDirectory(prefix="rig-view-")
        self._path = Path(self._folder.name) / f"{name}.mcap"
        self._head: ScratchHead | None = None
        self._writer: RecordWriter | None = None
        self._unit = DeflectionUnit.RAD
        self._failed = False
        self._sequence = self._last_ns = self._picture_due_ns = 0
        self._view = RunningView(self._path, mode, rrd, layout)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()
        problem = self._view.close(patient=True)
        self._folder.cleanup()
        if problem and error is None:
            raise RecordError(problem)

    @property
    def begun(self) -> bool:
        """Whether it has begun."""
        return self._head is not None

    def begin(self, time_ns: int, head: ScratchHead) -> None:
        """Begin the record."""
        self._head, self._unit = head, head.unit
        self._last_ns = self._picture_due_ns = time_ns
        self._writer = RecordWriter(
            self._path,
            0,
            metadata=head.metadata,
            attachments=head.attachments,
            deflection_unit=head.unit,
        )

    def block(
        self,
        block: Block,
        frames: Sequence[Frame] = (),
        shift_ns: int = 0,
        sequences: Sequence[int] | None = None,
    ) -> None:
        """Spots, half-cycles and balances, and a picture now and then; `shift_ns` is taken off all times.

        Frames are numbered as they come unless their `sequences` are given.
        """
        found = replace(block.deflections, times_ns=block.deflections.times_ns - shift_ns)
        times_ns = found.times_ns.tolist()
        numbers = sequences or range(self._sequence, self._sequence + len(times_ns))
        self._sequence = numbers[-1] + 1 if times_ns else self._sequence
        self._last_ns = times_ns[-1] if times_ns else self._last_ns

        def write(writer: RecordWriter) -> None:
            if times_ns:
                writer.write_spots(numbers, times_ns, times_ns, block.spots, found)
            for number, time_ns, seen in zip(numbers, times_ns, block.references, strict=False):
                writer.write(REFERENCE, RecordedReference.from_spot(number, time_ns, seen), time_ns)
            for swing in block.swings:
                writer.write_swing(replace(swing, turn_time_ns=swing.turn_time_ns - shift_ns))
            for balance in block.balances:
                writer.write_balance(replace(balance, time_ns=balance.time_ns - shift_ns))
            writer.flush_if_due()

        self._written(write)
        for frame in frames if sequences else frames[-1:]:
            number = frame.sequence if sequences else self._sequence - 1
            self._picture(Frame(frame.image, number, frame.time_ns - shift_ns, 0))

    def _picture(self, frame: Frame) -> None:
        if frame.time_ns >= self._picture_due_ns:
            self._picture_due_ns = frame.time_ns + _PICTURE_NS
            self._written(lambda writer: writer.write_preview(frame))

    def half_cycles(self, swings: list[HalfCycle]) -> None:
        """Half-cycles that are complete only at the end."""
        none = np.empty(0)
        nothing = Deflections(np.empty(0, dtype=np.int64), none, none, none, none, self._unit)
        self.block(Block([], nothing, swings, []))

    def look(self, frame: Frame, spot: Spot) -> None:
        """A frame and the spot in it, where no deflection is measured."""
        self._picture_due_ns = frame.time_ns
        self.block(self._alone(frame.time_ns, spot), [frame])

    def event(self, event: Event) -> None:
        """An event, for the log, or advice on the balance before it."""
        self._written(lambda writer: writer.write_event(event.time_ns, event.kind, event.text))

    def jump(self, time_ns: int, text: str) -> None:
        """Go on at a later time; curves are interrupted there, and the log says so."""
        self.block(self._alone(time_ns, _LOST))
        self.event(Event(time_ns, EventKind.START, text))

    def restart(self, time_ns: int) -> None:
        """Begin another record, which the view shows from now on."""
        self._last_ns = time_ns
        self._written(self._go_on_anew)

    def flush(self) -> None:
        """Have all shown that was written."""
        self._written(lambda writer: writer.flush())

    def _alone(self, time_ns: int, spot: Spot) -> Block:
        nothing, unit = np.full(1, math.nan), self._unit
        at = Deflections(np.array([time_ns]), nothing, nothing, nothing, nothing, unit)
        return Block([spot], at, [], [])

    def _written(self, write: Callable[[RecordWriter], None]) -> None:
        """Write into the record, where there is one that can be written."""
        if self._writer is None or self._failed:
            return
        try:
            if self._writer.bytes_written > self._most_bytes:
                self._go_on_anew(self._writer)
            write(self._writer)
        except (OSError, RecordError) as error:
            # the view ends, and nothing else
            self._failed = True
            say(f"the view ends: {error}")

    def _go_on_anew(self, full: RecordWriter) -> None:
        """Begin another record, as after a rejected start."""
        if self._head is None:
            return
        full.write_event(self._last_ns, EventKind.REJECTED, "restarted")
        self._end()
        aside = self._path.with_suffix(".old")
        # not removed before the next is there, which the system might give the same number
        self._path.rename(aside)
        pixels_beside(self._path).unlink(missing_ok=True)
        self.begin(self._last_ns, self._head)
        aside.unlink()

    def _end(self) -> None:
        if self._writer is not None:
            with suppress(RecordError):
                self._writer.close()
