"""Follows the program that has the devices: the session that runs on this machine, or a command."""

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
    ReferenceSpot,
    SessionBusy,
    SessionPicture,
    picture,
    running_sessions,
)
from rig.instrument import reference_px
from rig.measure import STATE_NAME, RunState, is_in_use, read_session
from rig.settings import Configuration, PreflightSettings, validate_configuration, without_schema

_LOOK_INTERVAL_S = 0.2
_SEARCH_INTERVAL_S = 1.0
_MAX_EVENTS = 300
_MAX_FOCUS_POINTS = 600
_MAX_END_ALARMS = 8


class RigFollower:
    """A thread that asks the program that has the devices for news.

    That is the running session, else a command with the rig. Without either the thread looks for a session in
    the folder `output`, and for the command in the folder `holder()`.
    """

    def __init__(self, output: Path, holder: Callable[[], Path | None] = lambda: None) -> None:
        self._output, self._holder = output, holder
        self.folder: Path | None = None
        """Folder of the running session; None without one."""
        self.command_folder: Path | None = None
        """Folder of the command that is followed; None without one."""
        self.news: dict[str, Any] = {}
        """The last answer of the program; empty without a program."""
        self.news_s = -math.inf
        """Monotonic time of the last answer."""
        self.beat_s = -math.inf
        """Monotonic time of a session's last other sign of life."""
        self.frame: AlignmentFrame | None = None
        """The last frame that was asked for."""
        self.focus: deque[tuple[float, float]] = deque(maxlen=_MAX_FOCUS_POINTS)
        """Sharpness in 1/px over monotonic time in s."""
        self.events: deque[dict[str, Any]] = deque(maxlen=_MAX_EVENTS)
        """Events of the session's records."""
        self.last_folder: Path | None = None
        """Folder of the last session, at first the newest in `output`."""
        self.is_fitting_last = False
        """Whether the process of the last session fits and reports."""
        self.end_alarms: deque[RaisedAlarm] = deque(maxlen=_MAX_END_ALARMS)
        """Alarms by the ends of sessions, until the list of alarms has them."""
        self.new_events: deque[dict[str, Any]] = deque(maxlen=_MAX_EVENTS)
        """Events, until the list of alarms has been updated by them."""
        self._connection: OrderConnection | None = None
        self._reader: RecordFollower | None = None
        self._stated_config: Configuration | None = None
        self._stop = threading.Event()
        self._wake = threading.Event()
        self._search_due_s = -math.inf
        self._picture_number = 0
        self._picture_lock = threading.Lock()

    def start(self) -> None:
        """Look for a session once, and then continuously in a thread."""
        self.last_folder = _newest_session(self._output)
        self.is_fitting_last = self.last_folder is not None
        self._search()
        for target in (self._follow, self._beat):
            threading.Thread(target=target, name="follower", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()
        self._wake.set()
        self._read("")

    @property
    def running(self) -> bool:
        return self.folder is not None

    @property
    def frozen(self) -> bool:
        """Whether the running session has given no sign of life for longer than a delay can explain."""
        return self.running and time.monotonic() - max(self.news_s, self.beat_s) > STALE_S

    @property
    def process(self) -> int | None:
        """Identifier of the running session's process; None before its first answer."""
        connection = self._connection
        return None if connection is None else connection.process

    @property
    def config(self) -> Configuration | None:
        """Configuration of the record, before a record that of the program; None if neither is known."""
        reader = self._reader
        recorded = None if reader is None else reader.config
        return recorded or self._stated_config

    @property
    def unit(self) -> str:
        """Unit of amplitudes and positions; empty while no configuration is known."""
        config = self.config
        return "" if config is None else config.deflection_unit.shown

    @property
    def safety(self) -> SafetyNow:
        """State of laser, controller and interlock by the last news."""
        return SafetyNow.from_news(self.news.get("safety") or {})

    @property
    def state(self) -> Mapping[str, Any]:
        """State of the run or of the live picture by the last news; empty before any."""
        return self.news.get("state") or {}

    @property
    def frames_age_s(self) -> float:
        """Age in s of the last frame that the program has processed; 0 before the first frame."""
        age_s = self.news.get("frames_age_s")
        return 0.0 if age_s is None else float(age_s) + time.monotonic() - self.news_s

    def search_now(self, folder: Path | None = None, config: Configuration | None = None) -> None:
        """Search at once: for the session of `folder`, or for the command of `config`, just started."""
        if folder is not None:
            self._output = folder.parent
        self._stated_config = config or self._stated_config
        self._search_due_s = -math.inf
        self._wake.set()

    def history(self) -> dict[str, list[Point]]:
        """Values for the chart from the record of the running session; empty without a record. Blocks."""
        reader = self._reader
        return {} if reader is None else reader.history()

    def order(self, order: str) -> str:
        """Give the program an order; raises RigError if it cannot be carried out."""
        folder = self.folder or self.command_folder
        if folder is None:
            raise NoSession("no session runs")
        with OrderConnection(folder) as connection:
            return connection.order(order)

    def ask_picture(self) -> None:
        """Read the newest picture into `frame`, and ask for the next; blocks for a moment.

        While another caller waits for a program that does not answer, the last frame stays.
        """
        connection = self._connection
        if connection is None or not self._picture_lock.acquire(blocking=False):
            return
        try:
            if (newest := connection.picture(self._picture_number)) is not None:
                self._picture_number = newest.number
                self.frame = self._alignment_frame(newest)
        except NoSession:
            return
        finally:
            self._picture_lock.release()

    def _alignment_frame(self, newest: SessionPicture) -> AlignmentFrame | None:
        """The frame with its figures; None while the program has no camera open."""
        if "full_scale_dn" not in newest.camera:
            return None
        full_scale_dn, config = int(newest.camera["full_scale_dn"]), self.config
        pendulum_image, reference = newest.image, None
        if config is not None and config.reference is not None and newest.reference is not None:
            row = config.reference.from_row_px
            reference = ReferenceSpot.in_image(newest.reference, row, newest.image, full_scale_dn)
            pendulum_image = newest.image[:row]
        figures = picture.figures(pendulum_image, full_scale_dn)
        self.focus.append((time.monotonic(), figures.sharpness_per_px))
        crosshair_px = reference_px(None if config is None else config.lever, pendulum_image.shape)
        # the settings of this frame: those of the news may be older or newer
        applied = CameraSettings.model_validate(newest.camera["applied"])
        return AlignmentFrame(
            newest.image,
            full_scale_dn,
            figures,
            newest.spot,
            crosshair_px,
            applied,
            newest.beam,
            reference,
            PreflightSettings() if config is None else config.preflight,
        )

    def _follow(self) -> None:
        while not self._stop.is_set():
            if self._connection is None:
                self._search()
            else:
                self._ask(self._connection)
            self._wake.wait(_LOOK_INTERVAL_S)
            self._wake.clear()
        if self._connection is not None:
            self._connection.close()

    def _beat(self) -> None:
        """Ask a session whose news are late, because its threads are busy, for a sign of life."""
        while not self._stop.wait(_LOOK_INTERVAL_S):
            folder = self.folder
            if folder is not None and time.monotonic() - self.news_s > _SEARCH_INTERVAL_S:
                with suppress(NoSession), OrderConnection(folder) as connection:
                    connection.beat()
                    self.beat_s = time.monotonic()

    def _search(self) -> None:
        if time.monotonic() >= self._search_due_s:
            self._search_due_s = time.monotonic() + _SEARCH_INTERVAL_S
            for folder in islice(running_sessions(self._output), 1):
                self._begin(folder, is_session=True)
            # a session that was not in use is not tested again: the test holds its lock for a moment
            if self._connection is None and self.is_fitting_last and self.last_folder is not None:
                self.is_fitting_last = is_in_use(self.last_folder)
        held_folder = self._holder() if self._connection is None else None
        # a session is found by its answer only: a session that was killed has held the rig, too
        if held_folder is not None and held_folder.absolute().parent != self._output.absolute():
            self._begin(held_folder, is_session=False)

    def _begin(self, folder: Path, *, is_session: bool) -> None:
        with suppress(NoSession):
            connection = OrderConnection(folder)
            self.frame, self._picture_number = None, 0
            self.focus.clear()
            if is_session:
                self._stated_config = _configuration_in(folder)
                self.events.clear()
                self.folder = self.last_folder = folder
                self.is_fitting_last, self.beat_s = False, -math.inf
            self._connection = connection
            self._ask(connection)

    def _ask(self, connection: OrderConnection) -> None:
        try:
            news = connection.news()
        except NoSession as error:
            is_busy = isinstance(error, SessionBusy)
            if self.folder is None:
                # news of a command that is busy stay, and their age grows
                if not is_busy:
                    self._leave(connection)
                return
            # a session that is busy, or was stopped, is still there, and takes orders
            is_busy = is_busy or time.monotonic() - self.news_s < _SEARCH_INTERVAL_S
            if not is_busy or not connection.process_lives or not _is_there(connection.folder):
                self.end_alarms.extend(_alarms_of_end(connection.folder))
                self.is_fitting_last = True
                self._leave(connection)
            return
        self._read(news["record"])
        if (reader := self._reader) is not None and reader.begun:
            news |= {"path": reader.path(), "balance": reader.balance}
        self.news, self.news_s = news, time.monotonic()
        self.command_folder = None if self.folder is not None else connection.folder

    def _leave(self, connection: OrderConnection) -> None:
        """Forget a program that has ended."""
        connection.close()
        self._connection = self.folder = self.command_folder = self.frame = None
        self.news = {}
        self._read("")

    def _read(self, record: str) -> None:
        """Read this record from now on; no record if the name is empty."""

        def on_event(event: dict[str, Any]) -> None:
            self.events.append(event)
            self.new_events.append(event)

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


def _newest_session(output: Path) -> Path | None:
    """Folder of the session that was changed last; None without any."""
    sessions = []
    for path in output.glob(f"*/{STATE_NAME}"):
        with suppress(OSError):
            sessions.append((path.stat().st_mtime_ns, path.parent))
    return max(sessions, default=(0, None))[1]


def phase_text(state: Mapping[str, Any]) -> str:
    """The phase of a run and its progress in words; empty if the state names no phase."""
    return ": ".join(filter(None, (state.get("phase"), state.get("progress"))))


def _alarms_of_end(folder: Path) -> list[RaisedAlarm]:
    """Alarms by the end of a session that does not answer any more; empty if it ended regularly."""
    if (folder / ORDERS_NAME).exists():
        # only a session that was killed leaves this file
        return [(AlarmKey.SESSION_DIED, f"{folder.name}: killed, or crashed")]
    try:
        entries = read_session(folder).entries
    except RigError:
        # a session without a record leaves no file
        return []
    if entries and entries[-1].state is RunState.FAILED:
        return [(AlarmKey.SESSION_FAILED, f"{folder.name}: {entries[-1].reason}")]
    return []


def _is_there(folder: Path) -> bool:
    """Whether a session takes connections in this folder."""
    try:
        OrderConnection(folder).close()
    except NoSession:
        return False
    return True
