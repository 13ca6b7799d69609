"""Follows what has the devices: the session that runs on this machine, or a command with the rig."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from acquisition.camera import CameraSettings
from processing.errors import RigError
from rig.control import STALE_S, SafetyNow
from rig.desk.alarm_list import AlarmKey, RaisedAlarm
from rig.desk.run_reader import Point, RecordFollower
from rig.devices import (
    ORDERS_NAME,
    AlignmentFrame,
    NoSession,
    OrderConnection,
    ReferencePart,
    SessionBusy,
    SessionPicture,
    middle_of,
    picture,
    running_sessions,
)
from rig.measure import STATE_NAME, RunState, is_in_use, read_session
from rig.settings import Configuration, validate_configuration, without_schema

_LOOK_S = 0.2
_SEARCH_S = 1.0
_EVENTS_KEPT = 300
_FOCUS_POINTS = 600


class Following:
    """A thread that asks whoever has the devices for news: the running session, else a command with the rig.

    Without either it looks for a session in `output`, and for the command in `holder()`. `folder` is that of
    the session, `held` that of the command (None without one). `news` is the last answer (empty without one),
    `heard_s` the monotonic time of it, `beat_s` that of a session's last other sign of life. `look` is the
    last frame that was asked for, `focus` the sharpness over time (seconds, 1/px).
    `events` are those of the session's records. `last_folder` is the folder of the last session, at first the
    newest of `output`, and `fits_last` is True while the process of that one fits and reports.
    `ended` are alarms of sessions that ended while they were followed, `unheard` are events; both wait until
    the alarms have been updated by them.
    """

    def __init__(self, output: Path, holder: Callable[[], Path | None] = lambda: None) -> None:
        self._output, self._holder = output, holder
        self.folder: Path | None = None
        self.held: Path | None = None
        self.news: dict[str, Any] = {}
        self.heard_s = self.beat_s = -math.inf
        self.look: AlignmentFrame | None = None
        self.focus: deque[tuple[float, float]] = deque(maxlen=_FOCUS_POINTS)
        self.events: deque[dict[str, Any]] = deque(maxlen=_EVENTS_KEPT)
        self.last_folder: Path | None = None
        self.fits_last = False
        self.ended: deque[RaisedAlarm] = deque(maxlen=8)
        self.unheard: deque[dict[str, Any]] = deque(maxlen=_EVENTS_KEPT)
        self._line: OrderConnection | None = None
        self._reader: RecordFollower | None = None
        self._stated: Configuration | None = None
        self._ended = threading.Event()
        self._wake = threading.Event()
        self._searched_s = -math.inf
        self._number = 0
        self._one_picture = threading.Lock()

    def start(self) -> None:
        """Look for a session once, and then continuously in a thread."""
        self.last_folder = _newest(self._output)
        self.fits_last = self.last_folder is not None
        self._search()
        for target in (self._follow, self._beat):
            threading.Thread(target=target, name="following", daemon=True).start()

    def stop(self) -> None:
        self._ended.set()
        self._wake.set()
        self._read("")

    @property
    def running(self) -> bool:
        """Whether a session runs."""
        return self.folder is not None

    @property
    def frozen(self) -> bool:
        """Whether the running session has given no sign of life for longer than a delay can explain."""
        return self.running and time.monotonic() - max(self.heard_s, self.beat_s) > STALE_S

    @property
    def process(self) -> int | None:
        """Number of the running session's process; None where it has never answered."""
        line = self._line
        return None if line is None else line.process

    @property
    def config(self) -> Configuration | None:
        """Configuration of the record, or before a record that of the program; None where none is known."""
        reader = self._reader
        recorded = None if reader is None else reader.config
        return recorded or self._stated

    @property
    def unit(self) -> str:
        """Unit of amplitudes and positions; empty where no configuration is known."""
        config = self.config
        return "" if config is None else config.deflection_unit.shown

    @property
    def safety(self) -> SafetyNow:
        """State of laser, controller and interlock as the program has told it."""
        return SafetyNow.from_news(self.news.get("safety") or {})

    @property
    def state(self) -> Mapping[str, Any]:
        """State of its run, or of its live picture; empty before it has told any."""
        return self.news.get("state") or {}

    @property
    def doing(self) -> str:
        """The phase of its run and its progress in words; empty before it has stated any."""
        return doing(self.state)

    @property
    def applied(self) -> CameraSettings:
        """Settings of the camera as last read back."""
        return CameraSettings.model_validate((self.news.get("camera") or {}).get("applied") or {})

    @property
    def frames_age_s(self) -> float:
        """Age in s of the last frame that the program has processed; 0 before the first one."""
        stated_s = self.news.get("frames_age_s")
        return 0.0 if stated_s is None else float(stated_s) + time.monotonic() - self.heard_s

    def look_now(self, folder: Path | None = None, stated: Configuration | None = None) -> None:
        """Look at once: for a session, that of `folder` if it was just started in another place.

        `stated` is the configuration of a command that was just started.
        """
        if folder is not None:
            self._output = folder.parent
        self._stated = stated or self._stated
        self._searched_s = -math.inf
        self._wake.set()

    def history(self) -> dict[str, list[Point]]:
        """Values for the chart from the record of the running session; empty without a record. Blocks."""
        reader = self._reader
        return {} if reader is None else reader.history()

    def order(self, name: str) -> str:
        """Give the program an order; raises RigError if it cannot be carried out."""
        folder = self.folder or self.held
        if folder is None:
            raise NoSession("no session runs")
        with OrderConnection(folder) as line:
            return line.order(name)

    def ask_picture(self) -> None:
        """Take the newest frame into `look`, and ask for the next; blocks for a moment.

        While another caller waits for a program that does not answer, the last frame stays.
        """
        line = self._line
        if line is None or not self._one_picture.acquire(blocking=False):
            return
        try:
            if (seen := line.picture(self._number)) is not None:
                self._number = seen.number
                self.look = self._looked(seen)
        except NoSession:
            return
        finally:
            self._one_picture.release()

    def _looked(self, seen: SessionPicture) -> AlignmentFrame | None:
        """The frame with its figures; None before the program has told its camera."""
        if "full_scale_dn" not in seen.camera:
            return None
        full_scale_dn, config = int(seen.camera["full_scale_dn"]), self.config
        own, reference = seen.image, None
        if config is not None and config.reference is not None and seen.reference is not None:
            row = config.reference.from_row_px
            reference = ReferencePart.in_image(seen.reference, row, seen.image, full_scale_dn)
            own = seen.image[:row]
        figures = picture.figures(own, full_scale_dn)
        self.focus.append((time.monotonic(), figures.sharpness_per_px))
        middle_px = middle_of(seen.image, None if config is None else config.lever_reference_px)
        # those of this frame: the news may have others already, or not yet
        applied = CameraSettings.model_validate(seen.camera["applied"])
        return AlignmentFrame(
            seen.image, full_scale_dn, figures, seen.spot, middle_px, applied, seen.beam, reference
        )

    def _follow(self) -> None:
        while not self._ended.is_set():
            if self._line is None:
                self._search()
            else:
                self._ask(self._line)
            self._wake.wait(_LOOK_S)
            self._wake.clear()
        if self._line is not None:
            self._line.close()

    def _beat(self) -> None:
        """Ask a session whose news are late for a sign of life.

        News wait for the threads that measure, and come late from a busy machine; a beat waits for nothing.
        """
        while not self._ended.wait(_LOOK_S):
            folder = self.folder
            if folder is not None and time.monotonic() - self.heard_s > _SEARCH_S:
                with suppress(NoSession), OrderConnection(folder) as line:
                    line.beat()
                    self.beat_s = time.monotonic()

    def _search(self) -> None:
        if time.monotonic() - self._searched_s >= _SEARCH_S:
            self._searched_s = time.monotonic()
            for folder in islice(running_sessions(self._output), 1):
                self._begin(folder, is_session=True)
            # one that was found free is not asked again: the look holds its lock for a moment
            if self._line is None and self.fits_last and self.last_folder is not None:
                self.fits_last = is_in_use(self.last_folder)
        held = self._holder() if self._line is None else None
        # a session is found by its answer only: one that was killed has held the rig, too
        if held is not None and held.absolute().parent != self._output.absolute():
            self._begin(held, is_session=False)

    def _begin(self, folder: Path, *, is_session: bool) -> None:
        with suppress(NoSession):
            line = OrderConnection(folder)
            self.look, self._number = None, 0
            self.focus.clear()
            if is_session:
                self._stated = _configuration_in(folder)
                self.events.clear()
                self.folder = self.last_folder = folder
                self.fits_last, self.beat_s = False, -math.inf
            self._line = line
            self._ask(line)

    def _ask(self, line: OrderConnection) -> None:
        try:
            news = line.news()
        except NoSession as why:
            is_busy = isinstance(why, SessionBusy)
            if self.folder is None:
                # news of a command that is busy stay, and their age grows
                if not is_busy:
                    self._leave(line)
                return
            # one that is busy, or was stopped, is still there, and may be given orders
            is_busy = is_busy or time.monotonic() - self.heard_s < _SEARCH_S
            if not is_busy or not line.process_lives or not _is_there(line):
                self.ended.extend(_alarms_of_end(line.folder))
                self.fits_last = True
                self._leave(line)
            return
        self._read(news["record"])
        if (reader := self._reader) is not None and reader.begun:
            news |= {"path": reader.path(), "balance": reader.balance}
        self.news, self.heard_s = news, time.monotonic()
        self.held = None if self.folder is not None else line.folder

    def _leave(self, line: OrderConnection) -> None:
        """Forget a program that has ended."""
        line.close()
        self._line = self.folder = self.held = self.look = None
        self.news = {}
        self._read("")

    def _read(self, record: str) -> None:
        """Read this record from now on; none, if it is empty."""

        def on_event(event: dict[str, Any]) -> None:
            for events in (self.events, self.unheard):
                events.append(event)

        if self._reader is not None and str(self._reader.record) != record:
            self._reader.close()
            self._reader = None
        if record and self._reader is None:
            self._reader = RecordFollower(Path(record), on_event)


def _configuration_in(folder: Path) -> Configuration | None:
    """Configuration of the session in a folder; None if there is no session that can be read."""
    path = str(folder / STATE_NAME)
    with suppress(RigError):
        return validate_configuration(without_schema(read_session(folder).configuration, path), path)
    return None


def _newest(output: Path) -> Path | None:
    """Folder of the session that was changed last; None without any."""
    found = []
    for path in output.glob(f"*/{STATE_NAME}"):
        with suppress(OSError):
            found.append((path.stat().st_mtime_ns, path.parent))
    return max(found, default=(0, None))[1]


def doing(state: Mapping[str, Any] | None) -> str:
    """The phase of a run and its progress in words; empty before it has stated any."""
    stated = state or {}
    return ": ".join(filter(None, (stated.get("phase"), stated.get("progress"))))


def _alarms_of_end(folder: Path) -> list[RaisedAlarm]:
    """Alarms by the end of a session that does not answer any more; empty if it ended as it should."""
    if (folder / ORDERS_NAME).exists():
        # only a session that was killed leaves this file
        return [(AlarmKey.SESSION_DIED, f"{folder.name}: killed, or crashed")]
    try:
        entries = read_session(folder).entries
    except RigError:
        # without a record it leaves nothing
        return []
    if entries and entries[-1].state is RunState.FAILED:
        return [(AlarmKey.SESSION_FAILED, f"{folder.name}: {entries[-1].reason}")]
    return []


def _is_there(line: OrderConnection) -> bool:
    try:
        OrderConnection(line.folder).close()
    except NoSession:
        return False
    return True
