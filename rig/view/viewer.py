"""The session's handle on the viewer: plain values in, nothing ever waits.

No Rerun call is made in this process: a viewer that stops reading would block it without limit.
What is handed over lies in a queue that drops the oldest; a thread feeds it to a worker's process,
batch by batch, each acknowledged. A worker that dies or does not answer in time is replaced; what it
held is counted as dropped. File and live stream have a worker each, so that no viewer that hangs can
spoil the file.
"""

import logging
import math
import subprocess
import time
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from processing.errors import ConfigurationError
from rig.rerun import (
    LOOPBACK,
    Balance,
    Curve,
    Fits,
    Floats,
    LayoutName,
    LogLevel,
    LogLine,
    Losses,
    Message,
    Mode,
    Picture,
    Samples,
    Setup,
    State,
    Swings,
    display_missing,
    free_port,
    open_window,
    page_address,
    start_page_server,
)
from rig.view.feed import Feed

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ViewCounts:
    """What became of what was handed to the view, samples and swings counted one by one.

    `sent` arrived in the worker and was drawn, `dropped` was lost on the way (by kind in
    `dropped_by_kind`). `restarts` counts workers that had to be replaced. `alive`: a worker is
    running and answering. `url`: where a viewer can connect, empty without a live stream.
    `notes`: what a person should know (a port that was taken, a screen that is missing, a full disk).
    """

    sent: int
    dropped: int
    dropped_by_kind: Mapping[str, int]
    restarts: int
    alive: bool
    url: str
    notes: tuple[str, ...]


class Viewer:
    """Live stream and .rrd file of one run, drawn by a process of its own.

    Every method but `close` returns at once, whatever the worker does, and may be called from any
    thread; arrays are copied. Without file and live stream nothing is started and everything is
    ignored.

    Parameters
    ----------
    rrd_path
        Rerun file to write; None for none. Must not exist yet. A replaced worker goes on in
        ``NAME-part2.rrd`` and so on; opened together the parts are one recording.
    mode
        Live stream: ``none``, ``spawn`` (a viewer window) or ``web`` (for a browser); both listen
        on 127.0.0.1 only.
    layout
        The layout that opens first; the file carries it too.
    title
        Shown in the viewer, e.g. the run's name.
    runs
        Names of the runs that are laid over each other; one unnamed run by default.
    period_s
        Expected period of the slow mode: the trajectory's last two periods are bright.
    amplitude_arcsec
        Largest amplitude expected: the trajectory's axes reach a little beyond it.
    unit
        Unit of deflections and amplitudes on every label: ``px`` where no calibration exists.
    memory_limit
        How much the live stream's server keeps for a viewer that connects late.
    port, web_port
        Preferred ports on 127.0.0.1. A free one is taken, and noted, where they are in use.
    queue_bytes
        How much may wait for the worker before the oldest is dropped.
    hang_limit_s
        A worker that has not drawn a batch within this time is replaced.
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
        amplitude_arcsec: float = 125.0,
        unit: str = "arcsec",
        memory_limit: str = "200MiB",
        port: int = 9876,
        web_port: int = 9090,
        queue_bytes: int = 64 << 20,
        hang_limit_s: float = 10.0,
        start_limit_s: float = 60.0,
    ) -> None:
        if rrd_path is not None and rrd_path.is_file():
            raise ConfigurationError(f"the Rerun file {rrd_path} exists already: choose another name")
        for name, value in (("period_s", period_s), ("amplitude_arcsec", amplitude_arcsec)):
            if not (math.isfinite(value) and value > 0):
                raise ConfigurationError(f"{name} of the view must be positive, not {value!r}")
        self._mode = mode
        self._web_port = web_port
        self._program: subprocess.Popen[bytes] | None = None
        self._viewer_port = 0
        self._notes: list[str] = []
        setup = Setup(
            title=title,
            recording_id=str(uuid.uuid4()),
            rrd_path=None,
            layout=layout,
            runs=tuple(runs),
            period_s=period_s,
            amplitude_arcsec=amplitude_arcsec,
            unit=unit,
            port=port,
            memory_limit=memory_limit,
            viewer_url="",
        )

        def feed(setup: Setup) -> Feed:
            return Feed(
                setup,
                queue_bytes=queue_bytes,
                hang_limit_s=hang_limit_s,
                start_limit_s=start_limit_s,
                note=self._note,
                on_ready=self._show if setup.rrd_path is None else lambda url: "",
            )

        self._file = feed(setup._replace(rrd_path=str(rrd_path))) if rrd_path is not None else None
        self._live = feed(setup) if mode != "none" else None
        self._feeds = [part for part in (self._file, self._live) if part is not None]

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self) -> None:
        """Start the workers; returns before they run. What comes meanwhile waits in the queue."""
        for feed in self._feeds:
            feed.start()

    def samples(
        self,
        times_s: ArrayLike,
        x_arcsec: ArrayLike,
        y_arcsec: ArrayLike,
        flags: ArrayLike,
        *,
        run: str = "",
    ) -> None:
        """Deflections of one or many frames, arrays of one length; NaN where the spot was lost."""
        if self._feeds:
            copied_flags = np.array(flags, dtype=np.int64, ndmin=1)
            self._put(Samples(run, _floats(times_s), _floats(x_arcsec), _floats(y_arcsec), copied_flags))

    def swings(
        self,
        times_s: ArrayLike,
        amplitude_arcsec: ArrayLike,
        period_s: ArrayLike,
        *,
        u_amplitude_arcsec: ArrayLike,
        u_period_s: ArrayLike,
        run: str = "",
    ) -> None:
        """Half-cycles of the slow mode at their turning points: amplitude and (whole) period."""
        if self._feeds:
            values = (times_s, amplitude_arcsec, u_amplitude_arcsec, period_s, u_period_s)
            self._put(Swings(run, *(_floats(value) for value in values)))

    def balance(
        self,
        time_s: float,
        numbers: Mapping[str, tuple[float, float]],
        *,
        advice: str = "",
        run: str = "",
    ) -> None:
        """Balance at one moment: value and standard uncertainty by name (see `rig.rerun.Balance`)."""
        if self._feeds:
            plain = {name: (float(value), float(u)) for name, (value, u) in numbers.items()}
            self._put(Balance(run, float(time_s), plain, advice))

    def image(
        self,
        time_s: float,
        image: NDArray[np.uint8] | NDArray[np.uint16],
        spot_px: tuple[float, float] = (math.nan, math.nan),
        *,
        full_scale_dn: int | None = None,
        run: str = "",
    ) -> None:
        """Camera image (ny, nx) and the spot (x, y) in it.

        `full_scale_dn` is shown white: by default what the image's type can hold. More than ten
        images a second of the run are not drawn.
        """
        if self._feeds:
            full = full_scale_dn if full_scale_dn is not None else int(np.iinfo(image.dtype).max)
            x_px, y_px = spot_px
            # A camera's frames are read-only and never written to again; anything else is copied.
            held = image.copy() if image.flags.writeable else image
            self._put(Picture(run, float(time_s), held, float(x_px), float(y_px), full))

    def losses(self, time_s: float, counts: Mapping[str, int], *, own: bool = True, run: str = "") -> None:
        """Losses since the start by name, e.g. ``dropped_frames``; with the view's `own`."""
        if self._feeds:
            view = {"view_dropped": self.counts.dropped} if own else {}
            self._put(Losses(run, float(time_s), {**counts, **view}))

    def state(self, text: str, *, time_s: float = math.nan, run: str = "") -> None:
        """State of the session, as Markdown; without a time it holds from the latest one on."""
        if self._feeds:
            self._put(State(run, float(time_s), text))

    def event(self, time_s: float, level: LogLevel, text: str, *, run: str = "") -> None:
        """One line of the log."""
        if self._feeds:
            self._put(LogLine(run, float(time_s), level, text))

    def fits(self, curves: Sequence[Curve], text: str = "", *, run: str = "") -> None:
        """Curves of the analysing layout and the report's text (Markdown)."""
        if self._feeds:
            self._put(Fits(run, tuple(curves), text))

    @property
    def counts(self) -> ViewCounts:
        """What was sent, dropped and restarted so far, file and live stream together."""
        dropped: Counter[str] = Counter()
        for feed in self._feeds:
            dropped.update(feed.queue.dropped)
        return ViewCounts(
            sent=sum(feed.sent for feed in self._feeds),
            dropped=dropped.total(),
            dropped_by_kind=dict(dropped),
            restarts=sum(feed.restarts for feed in self._feeds),
            alive=bool(self._feeds) and all(feed.alive for feed in self._feeds),
            url=self._live.url if self._live is not None else "",
            notes=tuple(self._notes),
        )

    def wait_room(self, limit_s: float = 60.0) -> None:
        """Wait until the queues are less than half full; for showing records, not for a live run."""
        deadline_s = time.monotonic() + limit_s
        while time.monotonic() < deadline_s and any(feed.queue.filling > 0.5 for feed in self._feeds):
            time.sleep(0.005)

    @property
    def worker_pids(self) -> tuple[int, ...]:
        """Processes of the workers."""
        return tuple(feed.worker_pid for feed in self._feeds if feed.worker_pid is not None)

    @property
    def program_pids(self) -> tuple[int, ...]:
        """Process of the program that shows the live stream, where one was started."""
        return (self._program.pid,) if self._program is not None else ()

    def close(self, timeout_s: float = 30.0) -> ViewCounts:
        """Send what waits, complete the file and end the workers; kill them after `timeout_s`."""
        deadline_s = time.monotonic() + timeout_s
        for feed in self._feeds:
            feed.close()
        for feed in self._feeds:
            feed.wait(deadline_s)
        if self._program is not None and self._mode == "web":
            self._program.kill()
            self._program.communicate()
        return self.counts

    def _put(self, message: Message) -> None:
        for feed in self._feeds:
            feed.queue.put(message)

    def _show(self, url: str) -> str:
        """Start the program that shows the stream, once; where it can be told of a new stream."""
        if self._program is None:
            try:
                if self._mode == "web":
                    port = free_port(self._web_port)
                    self._program = start_page_server(port)
                    self._note(f"live view: {page_address(port, url)}")
                elif missing := display_missing():
                    self._note(missing)
                else:
                    self._viewer_port = free_port(0)
                    self._program = open_window(url, self._viewer_port)
            except (OSError, subprocess.SubprocessError) as error:
                self._note(f"the viewer's program could not be started: {error}")
        elif self._mode == "web":
            self._note("the live view was started anew: reload the page")
        return f"rerun+http://{LOOPBACK}:{self._viewer_port}/proxy" if self._viewer_port else ""

    def _note(self, note: str) -> None:
        if note not in self._notes:
            self._notes.append(note)
            logger.warning("%s", note)


def _floats(values: ArrayLike) -> Floats:
    return np.array(values, dtype=np.float64, ndmin=1)
