"""Looks at everything the desk knows, ten times a second, and keeps the list of alarms; needs no page."""

import math
import threading
import time
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
_SECOND_LOOK_S = 0.4


class Alarming:
    """The alarms of a desk: `alarms` is their list."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self.alarms = AlarmList()
        self._ended = threading.Event()
        self._heard: tuple[object, int] = (None, 0)
        self._followed: Path | None = None
        self._trip: LatchedTrip | None = None
        self._begun: object = None
        self._late_since_s = math.inf

    def start(self) -> None:
        """Begin to look."""
        threading.Thread(target=self._again, name="alarms", daemon=True).start()

    def stop(self) -> None:
        """Look no more."""
        self._ended.set()

    def _again(self) -> None:
        while not self._ended.is_set():
            try:
                self._look()
            except Exception as error:
                # an alarm that cannot be judged is one
                self.alarms.see({}, [(AlarmKey.WATCHER, f"the desk's own watch: {error}")])
            self._ended.wait(_LOOK_S)

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
        found += self._of_started_session(trip)
        self.alarms.see(conditions(self._seen()), found)

    def _seen(self) -> Seen:
        desk, following = self._desk, self._desk.following
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
            picture_late_s=0.0 if desk.aligner is None else desk.aligner.late_s,
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
