"""Looks at everything the desk knows, ten times a second, and keeps the list of alarms; needs no page."""

import math
import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from processing.errors import RigError
from rig.alarms import AlarmKey, AlarmList, EndedSession, HowEnded, Seen, conditions, happened
from rig.control import STALE_S, LatchedTrip, SafetyNow
from rig.instrument import Phase
from rig.measure import read_session, state_of

if TYPE_CHECKING:
    from rig.desk.desk import Desk

_LOOK_S = 0.1
_SURROUNDINGS_S = 1.0
_KEEP_S = 0.5
_CLOCK_STEP_S = 0.5
_SECOND_LOOK_S = 0.4
_TOLD_KEPT = 64


class Surroundings:
    """Disk and configuration file; in a thread of their own, because a disk that hangs holds up no alarm."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self._was_there = desk.config.session.output.is_dir()
        self._read_ns = _changed_ns(desk.source)
        self.disk_free_bytes = math.inf
        self.folder_problem = self.configuration_problem = ""

    def look(self) -> None:
        """Look once; may take long."""
        output = self._desk.config.session.output
        self.folder_problem = self._problem_of(output)
        with suppress(OSError):
            self.disk_free_bytes = shutil.disk_usage(_nearest(output)).free
        changed_ns = _changed_ns(self._desk.source)
        if changed_ns == self._read_ns and not self.configuration_problem:
            return
        self._read_ns = changed_ns
        try:
            self._desk.checked()
            self.configuration_problem = ""
        except (RigError, OSError) as error:
            self.configuration_problem = str(error).splitlines()[0]

    def _problem_of(self, output: Path) -> str:
        there = output.is_dir()
        gone, self._was_there = self._was_there and not there, self._was_there or there
        if gone:
            return f"{output} is gone"
        place = _nearest(output)
        if not place.is_dir():
            return f"{place} is not a folder"
        return "" if os.access(place, os.W_OK | os.X_OK) else f"{place} may not be written to"


class Alarming:
    """The alarms of a desk: `alarms` is their list."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self.alarms = AlarmList()
        self._surroundings = Surroundings(desk)
        self._ended = threading.Event()
        self._listed = b""
        self._heard: tuple[object, int] = (None, 0)
        self._followed: Path | None = None
        self._trip: LatchedTrip | None = None
        self._told: deque[object] = deque(maxlen=_TOLD_KEPT)
        self._begun: object = None
        self._picture = (0, 0, 0.0)
        self._late_since_s = math.inf
        self._clocks_s = time.time() - time.monotonic()

    def start(self) -> None:
        """Begin to look, and go on with the list of the desk before."""
        self.alarms.restore(self._desk.place.alarms)
        for name, look, each_s in (
            ("alarms kept", self._keep, _KEEP_S),
            ("alarms", self._look, _LOOK_S),
            ("surroundings", self._surroundings.look, _SURROUNDINGS_S),
        ):
            threading.Thread(target=self._again, args=(look, each_s), name=name, daemon=True).start()

    def stop(self) -> None:
        """Look no more."""
        self._ended.set()
        self._keep()

    def _keep(self) -> None:
        """In a thread of its own, because a disk that hangs holds up no alarm."""
        if (listed := self.alarms.kept()) != self._listed:
            self._listed = listed
            self._desk.place.keep_alarms(listed)

    def _again(self, look: Any, each_s: float) -> None:
        while not self._ended.is_set():
            try:
                look()
            except Exception as error:
                # an alarm that cannot be judged is one
                self.alarms.see({}, [(AlarmKey.WATCHER, f"the desk's own watch: {error}")])
            self._ended.wait(each_s)

    def _look(self) -> None:
        following = self._desk.following
        before, self._followed = self._followed, following.folder
        if before is None and self._followed is not None:
            self.alarms.session_begins()
        events = self._new_events()
        # the end of a session is seen before the latch of a rig that ends with it
        trip, self._trip = self._desk.safety.trip or self._trip, self._desk.safety.trip
        found = happened(events, None, trip)
        while following.ended:
            found += happened([], following.ended.popleft(), trip)
        found += [*self._of_commands(), *self._of_started_session(trip), *self._of_clock()]
        self.alarms.see(conditions(self._seen()), found)

    def _seen(self) -> Seen:
        desk, following, around = self._desk, self._desk.following, self._surroundings
        news, safety = following.news, desk.safety.now
        running = following.running and bool(news)
        age_s = time.monotonic() - following.heard_s if running else 0.0
        return Seen(
            safety=safety,
            lit_by=self._lit_by(safety, age_s),
            news=news if running else {},
            news_age_s=age_s,
            beat_age_s=self._beat_age_s(),
            session="" if following.folder is None else following.folder.name,
            devices=following.devices,
            camera_event=following.camera_event,
            sensor_wanted=desk.config.environment_sensor.kind != "none",
            disk_free_bytes=around.disk_free_bytes,
            folder_problem=around.folder_problem,
            configuration_problem=around.configuration_problem,
            picture_late_s=self._picture_late_s(),
        )

    def _beat_age_s(self) -> float:
        """How long ago the session gave a sign of life; that it is late is believed at a second look.

        A desk that was held up itself finds everything late at its first one.
        """
        age_s, now_s = self._desk.following.heartbeat.age_s, time.monotonic()
        if age_s <= STALE_S:
            self._late_since_s = math.inf
            return age_s
        self._late_since_s = min(self._late_since_s, now_s)
        return age_s if now_s - self._late_since_s >= _SECOND_LOOK_S else STALE_S

    def _lit_by(self, safety: SafetyNow, news_age_s: float) -> str:
        aligner, following = self._desk.aligner, self._desk.following
        if aligner is not None and aligner.running and aligner.safety is not None:
            return "the live picture"
        measures = (following.news.get("state") or {}).get("phase") == Phase.MEASURING
        has_laser = following.devices.laser is not None
        return "the session" if following.running and measures and has_laser and news_age_s < 1.0 else ""

    def _picture_late_s(self) -> float:
        """For how long the live picture has stood still; 0 before its first frame."""
        aligner = self._desk.aligner
        if aligner is None or not aligner.running or not aligner.number:
            return 0.0
        now_s = time.monotonic()
        if self._picture[:2] != (id(aligner), aligner.number):
            self._picture = (id(aligner), aligner.number, now_s)
        return now_s - self._picture[2]

    def _new_events(self) -> list[dict[str, Any]]:
        following = self._desk.following
        folder, number = self._heard
        if folder != following.folder:
            number = 0
        events = [event for event in tuple(following.events) if event["number"] > number]
        if following.folder is None and not events:
            return []
        self._heard = (following.folder, max((int(event["number"]) for event in events), default=number))
        return events

    def _of_commands(self) -> Iterator[tuple[AlarmKey, str]]:
        desk = self._desk
        for name, job in [*tuple(desk.jobs.items()), *tuple(desk.looking_again.jobs.items())]:
            # a verdict that was printed is a result
            if job.status in (None, 0) or job.ending or "preflight" in job.newest or self._is_told(job):
                continue
            yield AlarmKey.COMMAND, f"rig {name}: {job.said[-1] if job.said else f'ended with {job.status}'}"
        aligner = desk.aligner
        if aligner is not None and aligner.problem and not self._is_told(aligner):
            yield AlarmKey.PICTURE, aligner.problem

    def _is_told(self, what: object) -> bool:
        if any(one is what for one in self._told):
            return True
        self._told.append(what)
        return False

    def _of_started_session(self, trip: LatchedTrip | None) -> Iterator[tuple[AlarmKey, str]]:
        """A session of this desk that has ended with an error before it could be followed."""
        begun = self._desk.started
        if begun is None or begun[0].poll() in (None, 0) or begun[0] is self._begun:
            return
        self._begun, folder = begun[0], begun[1]
        with suppress(RigError):
            if state_of(read_session(folder)) is not None:
                # what the file says was told when it ended
                return
        words = [line for line in self._desk.last_words() if line.strip()]
        reason = words[-1] if words else f"ended with {begun[0].returncode}"
        yield from happened([], EndedSession(folder.name, HowEnded.FAILED, reason), trip)

    def _of_clock(self) -> Iterator[tuple[AlarmKey, str]]:
        before_s, self._clocks_s = self._clocks_s, time.time() - time.monotonic()
        if abs(self._clocks_s - before_s) > _CLOCK_STEP_S:
            yield AlarmKey.HOST_CLOCK, f"by {self._clocks_s - before_s:+.1f} s"


def _nearest(folder: Path) -> Path:
    """The folder, or the nearest one above it that is there."""
    return next((place for place in (folder, *folder.absolute().parents) if place.exists()), Path("/"))


def _changed_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return -1
