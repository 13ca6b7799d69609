"""The view of `rig balance`: a scratch record of all its measurements, which `rig view` follows."""

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np

from acquisition.camera import CameraInfo, Frame
from acquisition.record.events import Event, EventKind
from acquisition.record.writer import RecordWriter
from processing.balance import Balance
from processing.deflections import Deflections
from processing.errors import RecordError
from processing.units import seconds
from rig.instrument import Block, configuration_attachments, session_metadata
from rig.settings import Configuration
from rig.terminal import say
from rig.view.replay import LOST_SPOT
from rig.view.running_view import RunningView
from rig.view.show import show_record

_PAUSE_NS, _PICTURE_INTERVAL_NS = 2_000_000_000, 300_000_000
_MAX_BYTES = 256 * 1024 * 1024
"""Largest size of the record, reached after an hour or more; later measurements are not shown."""


class BalanceView:
    """The view in the balancing layout, where measurements follow each other in time; a context manager.

    The view is opened at the first frame, if a live view or a Rerun file is configured. At the end the file
    is plotted, and the record removed. `advise` gives the text beside a balance; `report` all deflections.
    """

    def __init__(
        self,
        config: Configuration,
        rrd: Path | None,
        advise: Callable[[Balance], str],
        report: Callable[[Deflections], None],
    ) -> None:
        self._config, self._rrd = config, rrd
        self._advise, self._report = advise, report
        self._writer: RecordWriter | None = None
        self._has_ended = False
        self._frames = self._shift_ns = self._shown_ns = self._picture_due_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_error: object) -> None:
        if self._writer is None:
            return
        with self._folder, suppress(RecordError) if kind is not None else nullcontext():
            with suppress(RecordError):
                self._writer.close()
            self._view.close()
            if self._rrd is not None:
                show_record(self._writer.path, rrd=self._rrd, layout="balancing")

    def begin(self, first: Frame, info: CameraInfo) -> None:
        """Begin a measurement; the frames' clock may have been reset."""
        config = self._config
        if config.view.mode == "none" and self._rrd is None:
            return
        if self._writer is None:
            self._folder = tempfile.TemporaryDirectory(prefix="rig-view-")
            path = Path(self._folder.name) / "balancing.mcap"
            self._view = RunningView(path, config.view.mode, "balancing")
            self._writer = RecordWriter(
                path,
                time.time_ns(),
                metadata=session_metadata(config, info, first),
                attachments=configuration_attachments(config, Path()),
                deflection_unit=config.deflection_unit,
            )
            self._write(None, [Event(0, EventKind.START, "first frame")])
        else:
            # a lost spot interrupts the curves
            self._shown_ns += _PAUSE_NS
            text = f"restarted at {seconds(self._shown_ns):.1f} s"
            nan = np.full(1, math.nan)
            lost = Deflections(np.array([self._shown_ns]), nan, nan, nan, nan, config.deflection_unit)
            self._write(Block([LOST_SPOT], lost), [Event(self._shown_ns, EventKind.START, text)])
        self._shift_ns = first.time_ns - self._shown_ns

    def block(self, frames: Sequence[Frame], block: Block) -> None:
        """Show processed frames."""
        self._report(block.deflections)
        if self._writer is None or not frames:
            return
        shift_ns = self._shift_ns
        balances = [replace(balance, time_ns=balance.time_ns - shift_ns) for balance in block.balances]
        shifted = block._replace(
            deflections=replace(block.deflections, times_ns=block.deflections.times_ns - shift_ns),
            half_cycles=[replace(h, turn_time_ns=h.turn_time_ns - shift_ns) for h in block.half_cycles],
            balances=balances,
        )
        advice = [Event(balance.time_ns, EventKind.ADVICE, self._advise(balance)) for balance in balances]
        self._shown_ns = frames[-1].time_ns - shift_ns
        self._write(shifted, advice, frames[-1]._replace(device_time_ns=self._shown_ns))

    def _write(self, block: Block | None, events: Sequence[Event], frame: Frame | None = None) -> None:
        """Write into the record, with a picture at intervals; an error ends only the view."""
        writer = self._writer
        if writer is None or self._has_ended:
            return
        try:
            if block is not None:
                times_ns = block.deflections.times_ns.tolist()
                numbers = range(self._frames, self._frames + len(times_ns))
                self._frames += len(times_ns)
                writer.write_spots(numbers, times_ns, times_ns, block.spots, block.deflections)
                for half_cycle in block.half_cycles:
                    writer.write_half_cycle(half_cycle)
                for balance in block.balances:
                    writer.write_balance(balance)
            if frame is not None and frame.time_ns >= self._picture_due_ns:
                self._picture_due_ns = frame.time_ns + _PICTURE_INTERVAL_NS
                writer.write_preview(frame._replace(sequence=self._frames - 1))
            for event in events:
                writer.write_event(*event)
            writer.flush_if_due()
            if writer.bytes_written > _MAX_BYTES:
                self._has_ended = True
                say(f"the view ends: its record has {_MAX_BYTES >> 20} MB; start rig balance again for more")
        except (OSError, RecordError) as error:
            self._has_ended = True
            say(f"the view ends: {error}")
