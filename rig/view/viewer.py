"""The viewer of a run: passes data to worker processes that draw them, and never blocks.

No Rerun call is made in this process, because a viewer that stops reading would block it forever.
Data are put into a queue that drops the oldest; a thread sends them in batches to a worker process,
which acknowledges each batch. A worker that dies or does not answer in time is replaced, and the data
it held are counted as dropped. File and live stream have separate workers, so that a viewer that
hangs cannot damage the file.
"""

import logging
import math
import os
import shutil
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from acquisition.frame import Frame
from acquisition.record.events import Event, Level
from processing.balance import Balance
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.errors import ConfigurationError, RecordError
from processing.spot import Spot, SpotFlag
from processing.ticks import seconds
from rig.instrument import Block, CameraClock, Phase, Snapshot
from rig.presentation import balance_numbers
from rig.rerun import (
    LayoutName,
    Message,
    Mode,
    Setup,
    Trouble,
)
from rig.view.feed import Feed
from rig.view.shown_values import ShownValues
from rig.view.state_text import empty_panels, state_text
from rig.view.viewer_program import ViewerProgram

logger = logging.getLogger(__name__)

_STATE_INTERVAL_S = 0.5
_GATHERED_NS = 50_000_000
"""Samples of a run that are passed on together."""
_FULL_BYTES = 1 << 20
"""With less than this a disk is called full."""


@dataclass(frozen=True, slots=True)
class ViewCounts:
    """Counts of the data passed to the view; samples and swings are counted individually.

    `sent` were drawn by the worker, `dropped` were lost. `restarts` is the number of replaced
    workers. `alive`: a worker is running and answering. `url`: address for a viewer, empty without a live
    stream. `notes`: messages to the user (a port in use, a missing
    display, a full disk), `troubles` what they are about.
    """

    sent: int
    dropped: int
    restarts: int
    alive: bool
    url: str
    notes: tuple[str, ...]
    troubles: frozenset[Trouble]


class Viewer(ShownValues):
    """Live stream and .rrd file of one run, drawn by separate processes.

    It is a watcher of a run (`block`, `event`, `snapshot`), and takes the plain values of `ShownValues`.
    Every method except `close` and `wait_room` returns immediately and may be called from any thread; arrays
    are copied. Without file and live stream nothing is started and all data are ignored.

    Parameters
    ----------
    rrd_path
        Rerun file to write, or None. Must not exist yet. A replacement worker continues in
        ``NAME-part2.rrd`` and so on; opened together the parts are one recording.
    mode
        Live stream: ``none``, ``spawn`` (a viewer window) or ``web`` (for a browser); both listen
        on 127.0.0.1 only.
    layout
        The layout that opens first; also stored in the file.
    title
        Shown in the viewer, e.g. the run's name.
    runs
        Names of the overlaid runs; one unnamed run by default.
    period_s
        Expected period of the slow mode; the last two periods of the trajectory are drawn bright.
    amplitude
        Largest expected amplitude, in arcsec (px without a lever), for the axes of the trajectory.
    unit
        Unit of deflections and amplitudes.
    image_interval_s
        Shortest interval, in the host's time, between the images of a run.
    full_scale_dn
        Pixel value shown white; default: the largest value of the image's type.
    parameters
        Keys of those that are estimated while the run is measured.
    has_reference
        There is a reference spot, which gets a panel.
    advise
        Returns advice for a balance, in Markdown.
    memory_limit
        Amount of data that the live stream's server keeps for a viewer that connects late.
    port, web_port
        Preferred ports on 127.0.0.1. If one is in use, a free port is taken and noted.
    queue_bytes
        Size of the queue to the worker, beyond which the oldest data are dropped.
    hang_limit_s
        A worker that has not drawn a batch within this time is replaced.

    Raises
    ------
    processing.errors.ConfigurationError
        The file exists already; period or amplitude are not positive.
    """

    def __init__(
        self,
        rrd_path: Path | None,
        mode: Mode = "none",
        layout: LayoutName = "measuring",
        title: str = "optical pendulum",
        *,
        runs: Sequence[str] = ("",),
        period_s: float = 4.07,
        amplitude: float = 125.0,
        unit: DeflectionUnit = DeflectionUnit.RAD,
        image_interval_s: float = 0.0,
        full_scale_dn: int | None = None,
        parameters: Sequence[str] = (),
        has_reference: bool = False,
        advise: Callable[[Balance], str] = lambda _: "",
        memory_limit: str = "200MiB",
        port: int = 9876,
        web_port: int = 9090,
        queue_bytes: int = 64 << 20,
        hang_limit_s: float = 10.0,
    ) -> None:
        if rrd_path is not None and rrd_path.is_file():
            raise ConfigurationError(f"the Rerun file {rrd_path} exists already; choose another name")
        if rrd_path is not None and rrd_path.is_dir():
            raise ConfigurationError(f"the Rerun file {rrd_path} is a folder; name a file in it")
        if rrd_path is not None and not os.access(rrd_path.parent, os.W_OK | os.X_OK):
            what = "cannot be written to" if rrd_path.parent.is_dir() else "is not there"
            raise ConfigurationError(f"the Rerun file {rrd_path}: the folder {rrd_path.parent} {what}")
        for name, value in (("period_s", period_s), ("amplitude", amplitude)):
            if not (math.isfinite(value) and value > 0):
                raise ConfigurationError(f"{name} of the view must be positive, not {value!r}")
        super().__init__(unit, parameters, full_scale_dn)
        self._image_interval_s = image_interval_s
        self._advise = advise
        self._estimated_from = 0
        self._shown_clock = CameraClock()
        self._balanced = False
        self._start_ns = 0
        self._gathered: list[Deflections] = []
        self._flags: list[int] = []
        self._references: list[Spot] = []
        self._next_image_s = 0.0
        self._next_state_s = 0.0
        self._shown_phase: Phase | None = None
        self._notes: dict[str, Trouble] = {}
        self._program = ViewerProgram(mode, web_port, self._note)
        setup = Setup(
            title=title,
            recording_id=str(uuid.uuid4()),
            rrd_path=None,
            layout=layout,
            runs=tuple(runs),
            period_s=period_s,
            amplitude=amplitude,
            unit=unit.shown,
            port=port,
            memory_limit=memory_limit,
            viewer_url="",
            parameters={key: shown.label for key, shown in self._parameters.items()},
            has_reference=has_reference,
        )

        def feed(setup: Setup) -> Feed:
            return Feed(
                setup,
                queue_bytes=queue_bytes,
                hang_limit_s=hang_limit_s,
                note=self._note,
                on_ready=self._program.show if setup.rrd_path is None else lambda url: "",
            )

        self._rrd_path = rrd_path
        self._file = feed(setup._replace(rrd_path=str(rrd_path))) if rrd_path is not None else None
        self._live = feed(setup) if mode != "none" else None
        self._feeds = [part for part in (self._file, self._live) if part is not None]

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def start(self) -> None:
        """Start the workers; returns before they run. Data wait in the queue until then."""
        for feed in self._feeds:
            feed.start()

    # -- as a watcher of a run -----------------------------------------------

    def block(self, start_ns: int, frames: Sequence[Frame], block: Block) -> None:
        """Deflections, swings, balance and now and then an image."""
        found = block.deflections
        if start_ns != self._start_ns:
            self._send_gathered()
            self._start_ns = start_ns
        if len(found):
            self._gathered.append(found)
            self._flags += [spot.flags for spot in block.spots]
            self._references += block.references
            if found.times_ns[-1] - self._gathered[0].times_ns[0] >= _GATHERED_NS:
                self._send_gathered()
        else:
            self._send_gathered()
        if block.swings:
            self.swings(block.swings, start_ns)
        for balance in block.balances:
            self._balanced = True
            time_s = seconds(balance.time_ns - start_ns)
            self.balance(time_s, balance_numbers(balance), advice=self._advise(balance))
        now_s = time.monotonic()
        if frames and now_s >= self._next_image_s:
            self._next_image_s = now_s + self._image_interval_s
            self.picture(start_ns, frames[-1], block.spots[-1])

    def _send_gathered(self) -> None:
        if self._gathered:
            found, flags, seen = joined(self._gathered, self._unit), self._flags, self._references
            self._gathered, self._flags, self._references = [], [], []
            times_s = seconds(found.times_ns - self._start_ns)
            self.samples(times_s, found.shown_x, found.shown_y, flags)
            if len(seen) == len(times_s):
                x_px, y_px = [one.x_px for one in seen], [one.y_px for one in seen]
                self.reference(times_s, x_px, y_px, [one.flags & SpotFlag.LOST for one in seen])

    def picture(self, start_ns: int, frame: Frame, spot: Spot) -> None:
        """A whole frame and the spot in it."""
        lost = bool(spot.flags & SpotFlag.LOST)
        place = (math.nan, math.nan) if lost else (spot.x_px, spot.y_px)
        self.image(seconds(frame.time_ns - start_ns), frame.image, place)

    def jump(self, time_s: float) -> None:
        """Continue at another time; curves are interrupted there."""
        self._send_gathered()
        self.samples(time_s, math.nan, math.nan, 0)
        self.log(time_s, Level.INFORMATION, f"restarted at {time_s:.1f} s")

    def event(self, start_ns: int, event: Event, *, run: str = "") -> None:
        """Write an event to the log."""
        time_s = seconds(event.time_ns - start_ns)
        self.log(time_s, event.level, event.line, kind=event.kind, run=run)

    def snapshot(self, snapshot: Snapshot) -> None:
        """State and losses, at most twice a second, and when the phase changes; all that is newly known."""
        if snapshot.estimated_from != self._estimated_from:
            self._estimated_from = snapshot.estimated_from
            self.estimates(snapshot.elapsed_s, snapshot.estimates)
        if snapshot.clock != self._shown_clock and snapshot.clock.known:
            self._shown_clock = snapshot.clock
            self.clock(snapshot.elapsed_s, snapshot.clock.drift_ppm, snapshot.clock.u_drift_ppm)
        now_s = time.monotonic()
        if now_s < self._next_state_s and snapshot.phase is self._shown_phase:
            return
        self._shown_phase = snapshot.phase
        self._next_state_s = now_s + _STATE_INTERVAL_S
        with_lever = self._unit is DeflectionUnit.RAD
        empty = empty_panels(snapshot, self._parameters, balanced=self._balanced, with_lever=with_lever)
        at = time.strftime("%H:%M:%S")
        self.state(state_text(snapshot, self._unit, at, empty), time_s=snapshot.elapsed_s)
        counts = {"dropped_frames": snapshot.dropped_frames, "lost_spots": snapshot.lost_spots}
        self.losses(snapshot.elapsed_s, counts)

    # -- how it fares --------------------------------------------------------------

    @property
    def _dropped(self) -> int:
        return self.counts.dropped

    @property
    def counts(self) -> ViewCounts:
        """Counts so far, of file and live stream together."""
        return ViewCounts(
            sent=sum(feed.sent for feed in self._feeds),
            dropped=sum(feed.queue.dropped for feed in self._feeds),
            restarts=sum(feed.restarts for feed in self._feeds),
            alive=bool(self._feeds) and all(feed.alive for feed in self._feeds),
            url=self._live.url if self._live is not None else "",
            notes=tuple(self._notes),
            troubles=frozenset(self._notes.values()),
        )

    @property
    def worker_pids(self) -> tuple[int, ...]:
        """Process numbers of the workers."""
        return tuple(feed.worker_pid for feed in self._feeds if feed.worker_pid is not None)

    @property
    def program_pids(self) -> tuple[int, ...]:
        """Process number of the program that shows the live stream, if it was started."""
        return self._program.pids

    def wait_room(self, limit_s: float = 60.0) -> None:
        """Wait until the queues are less than half full; for showing records, not for a live run."""
        deadline_s = time.monotonic() + limit_s
        while time.monotonic() < deadline_s and any(feed.queue.filling > 0.5 for feed in self._feeds):
            time.sleep(0.005)

    def close(self, timeout_s: float = 30.0) -> ViewCounts:
        """Send the queued data, complete the file and end the workers; kill them after `timeout_s`."""
        self._send_gathered()
        deadline_s = time.monotonic() + timeout_s
        for feed in self._feeds:
            feed.close()
        for feed in self._feeds:
            feed.wait(deadline_s)
        self._program.close()
        return self.counts

    def check_file(self) -> None:
        """After `close`: raises RecordError where the Rerun file is gone or lacks anything."""
        if self._file is None or self._rrd_path is None:
            return
        dropped = self._file.queue.dropped
        if not self._rrd_path.exists():
            why = "it was removed while it was written"
        elif dropped:
            full = shutil.disk_usage(self._rrd_path.parent).free < _FULL_BYTES
            why = f"{dropped} values are not in it{', the disk is full' if full else ''}"
        else:
            lacking = (Trouble.FILE_ENDED, Trouble.NOT_DRAWN)
            notes = [note for note, trouble in self._notes.items() if trouble in lacking]
            if not notes:
                return
            why = notes[0]
        raise RecordError(f"the Rerun file {self._rrd_path} is not whole: {why}; make it again elsewhere")

    def _put(self, message: Message) -> None:
        for feed in self._feeds:
            feed.queue.put(message)

    def _note(self, note: str, trouble: Trouble = Trouble.NONE) -> None:
        if note not in self._notes:
            self._notes[note] = trouble
            logger.warning("%s", note)
