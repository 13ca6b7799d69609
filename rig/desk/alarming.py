"""Raises the alarms of a desk ten times a second, with or without a page, from news and events."""

import math
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from acquisition.frames.queue import take_all
from acquisition.record.events import EventKind, Severity
from processing.errors import RigError
from rig.control import STALE_S, ControlState, LatchedTrip, Light, Loop, SafetyNow, TripCause
from rig.desk.alarm_list import AlarmKey, AlarmList, RaisedAlarm
from rig.desk.jobs import StartedSession
from rig.instrument import Phase
from rig.measure import MIN_FREE_BYTES, read_session, state_of

if TYPE_CHECKING:
    from rig.desk.desk import Desk


_MIN_SPOT_LOSS_S = 0.5
"""Shortest loss of the spot that is an alarm; shorter losses are data."""
_MAX_FRAME_AGE_S = 1.5
_MAX_NEWS_AGE_S = 10.0
"""Age of the news that a session never reaches on a busy machine, where they are late by seconds."""
_SILENT: Final = (Light.SILENT, Light.CONTROLLER_SILENT)
_PHASES_WITH_FRAMES: Final = frozenset({Phase.REST, Phase.WARM_UP, Phase.RELEASE, Phase.MEASURING})
_ALARM_BY_EVENT: Final[Mapping[str, AlarmKey]] = {
    EventKind.FAILED: AlarmKey.SESSION_FAILED,
    EventKind.RECORD: AlarmKey.DISK_FULL,
}
"""Alarms by the kinds of events that have their own."""
_IGNORED_WARNINGS: Final = frozenset({EventKind.ENDED_EARLY, EventKind.SPOT_LOST})
"""Kinds of warnings that a person caused, or that are alarms by a condition."""
_DARKNESS_EVENTS: Final = frozenset({EventKind.LIGHT_STEP, EventKind.REST_STEP, EventKind.PUSH})
"""Kinds of events that frames without light cause."""
_DARKNESS_ALARMS: Final = frozenset({AlarmKey.LASER_DARK, AlarmKey.SPOT, AlarmKey.BALANCE})
"""Alarms by conditions that frames without light cause."""


def conditions(
    safety: SafetyNow,
    news: Mapping[str, Any],
    *,
    session: str = "",
    news_age_s: float = 0.0,
    beat_age_s: float = math.inf,
    lit_by: str = "",
    sensor_configured: bool = False,
    picture_age_s: float = 0.0,
) -> dict[AlarmKey, str]:
    """The alarms whose conditions hold, each with its cause.

    `news` is what the running `session` said `news_age_s` ago, empty without a session; `beat_age_s` is the
    age of its last sign of life. `lit_by` names the program that has the laser. The live picture has stood
    still for `picture_age_s`. A press of LIGHT OFF is no alarm. Nor are consequences of a trip while the
    trip is latched, and until a person who has acknowledged it has asked for light.
    """
    alarms = dict(_light_alarms(safety, lit_by))
    state = news.get("state") or {}
    if news:
        if min(news_age_s, beat_age_s) > STALE_S:
            alarms[AlarmKey.SESSION_FROZEN] = f"{session} has said nothing for more than 2 s"
        elif news_age_s > _MAX_NEWS_AGE_S:
            silence = f"{session} answers, but has told nothing for {_MAX_NEWS_AGE_S:g} s"
            alarms[AlarmKey.SESSION_FROZEN] = silence
        alarms |= _session_alarms(news, state, safety.light)
    if sensor_configured and state.get("phase") == Phase.MEASURING and state.get("temperature_c") is None:
        alarms[AlarmKey.ENVIRONMENT] = "the sensor of the environment does not answer"
    if picture_age_s > STALE_S:
        alarms[AlarmKey.CAMERA] = "the live picture is frozen"
    consequences = _DARKNESS_ALARMS if safety.trip is not None or safety.needs_request else frozenset()
    return {key: cause for key, cause in alarms.items() if key not in consequences}


def event_alarms(
    events: Iterable[Mapping[str, Any]], ends: Iterable[RaisedAlarm], trip: LatchedTrip | None = None
) -> list[RaisedAlarm]:
    """Alarms by a session's new warnings and its end; consequences of a `trip` are no alarms.

    A session that ends because a person has pressed LIGHT OFF has not failed.
    """
    ignored = _IGNORED_WARNINGS if trip is None else _IGNORED_WARNINGS | _DARKNESS_EVENTS
    alarms = []
    for event in events:
        kind, text = str(event["kind"]), str(event["text"])
        if kind in _ALARM_BY_EVENT:
            alarms.append((_ALARM_BY_EVENT[kind], text))
        elif event["level"] == Severity.WARNING and kind not in ignored:
            alarms.append((AlarmKey.DISTURBED, f"{kind}: {text}"))
    alarms += ends
    if trip is not None and trip.cause is TripCause.PERSON:
        alarms = [alarm for alarm in alarms if alarm[0] is not AlarmKey.SESSION_FAILED]
    return alarms


def _light_alarms(safety: SafetyNow, lit_by: str) -> Iterator[RaisedAlarm]:
    if safety.trip is not None and safety.trip.cause is not TripCause.PERSON:
        yield AlarmKey.TRIP, safety.trip.text
    if safety.light is Light.DISAGREES:
        yield AlarmKey.LIGHT_DISAGREES, "the laser's output, or its light in the picture, is seen to be on"
    if safety.interlock is Loop.OPEN and safety.interlock_age_s <= STALE_S:
        yield AlarmKey.INTERLOCK, "a door, a cover or the connector of the loop is open"
    is_silent = safety.light in _SILENT
    is_unknown = is_silent or safety.light is Light.UNKNOWN or safety.light_age_s > STALE_S
    if lit_by and is_unknown and not math.isinf(safety.light_age_s):
        silence = str(safety.light) if is_silent else "nothing was heard of for more than 2 s"
        yield AlarmKey.LASER_UNKNOWN, f"{lit_by} has the laser, which {silence}"
    if safety.controller not in (None, ControlState.OPEN):
        yield AlarmKey.CONTROLLER, str(safety.controller)


def _session_alarms(news: Mapping[str, Any], state: Mapping[str, Any], light: Light) -> Iterator[RaisedAlarm]:
    alarm = str(state.get("alarm") or "")
    if float(state.get("disk_silent_s") or 0.0):
        yield AlarmKey.DISK_HANGS, "a write to the record takes more than 2 s"
    elif alarm and news.get("darkness"):
        yield (AlarmKey.LASER_UNKNOWN if light in _SILENT else AlarmKey.LASER_DARK), alarm
    elif alarm:
        yield AlarmKey.STALLED, alarm
    if state.get("phase") in _PHASES_WITH_FRAMES:
        yield from _frame_alarms(news)
    failed_checks = (news.get("balance") or {}).get("failed_checks") or ()
    if failed_checks and state.get("phase") == Phase.MEASURING:
        yield AlarmKey.BALANCE, "; ".join(map(str, failed_checks))
    failed = [str(row["name"]) for row in news.get("preflight") or () if not row.get("ok", True)]
    if failed and state.get("phase") == Phase.PREFLIGHT:
        yield AlarmKey.PREFLIGHT, ", ".join(failed)
    yield from _disk_alarms(state)


def _frame_alarms(news: Mapping[str, Any]) -> Iterator[RaisedAlarm]:
    rate_hz = ((news.get("camera") or {}).get("applied") or {}).get("frame_rate_hz")
    max_age_s = max(_MAX_FRAME_AGE_S, 3.0 / float(rate_hz)) if rate_hz else _MAX_FRAME_AGE_S
    if float(news.get("frames_age_s") or 0.0) > max_age_s:
        yield AlarmKey.CAMERA, f"none for more than {max_age_s:.2g} s"
    elif float(news.get("spot_lost_s") or 0.0) > _MIN_SPOT_LOSS_S:
        yield AlarmKey.SPOT, "the beam is blocked or misses the sensor, or the swing is too large"


def _disk_alarms(state: Mapping[str, Any]) -> Iterator[RaisedAlarm]:
    free_bytes, bytes_per_s = state.get("disk_free_bytes"), state.get("record_bytes_per_s")
    if free_bytes is None or not bytes_per_s:
        return
    room_s = max(float(free_bytes) - MIN_FREE_BYTES, 0.0) / float(bytes_per_s)
    remaining_s = state.get("remaining_s")
    needed_s = float((state.get("at_most_s") or 0.0) if remaining_s is None else remaining_s)
    if room_s < needed_s < math.inf:
        text = f"room for {room_s / 60:.0f} min, needed for {needed_s / 60:.0f} min"
        yield AlarmKey.DISK_FORECAST, text


_LOOK_INTERVAL_S = 0.1


class Alarming:
    """The alarms of a desk: `alarms` is their list."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self.alarms = AlarmList()
        self._stop = threading.Event()
        self._was_running = False
        self._trip: LatchedTrip | None = None
        self._judged_start: StartedSession | None = None

    def start(self) -> None:
        threading.Thread(target=self._look_repeatedly, name="alarms", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _look_repeatedly(self) -> None:
        while not self._stop.is_set():
            try:
                self._look()
            except Exception as error:
                # alarms that cannot be judged are an alarm
                self.alarms.update({}, [(AlarmKey.WATCHER, f"the desk's own watch: {error}")])
            self._stop.wait(_LOOK_INTERVAL_S)

    def _look(self) -> None:
        follower = self._desk.follower
        was_running, self._was_running = self._was_running, follower.running
        if self._was_running and not was_running:
            self.alarms.session_begins()
        # a trip of the last look counts, too: the latch of a simulated rig ends with its session
        trip, self._trip = self._desk.safety.trip or self._trip, self._desk.safety.trip
        events = take_all(follower.new_events)
        ends = [*take_all(follower.end_alarms), *self._start_alarms()]
        news = follower.news if follower.running else {}
        news_age_s = time.monotonic() - follower.news_s if news else 0.0
        present = conditions(
            self._desk.safety.now,
            news,
            session="" if follower.folder is None else follower.folder.name,
            news_age_s=news_age_s,
            beat_age_s=time.monotonic() - follower.beat_s,
            lit_by=self._lit_by(news_age_s),
            sensor_configured=self._desk.config.environment_sensor.kind != "none",
            picture_age_s=follower.frames_age_s if self._has_picture else 0.0,
        )
        self.alarms.update(present, event_alarms(events, ends, trip))

    @property
    def _has_picture(self) -> bool:
        """Whether a live picture has answered, and was not asked to end."""
        job = self._desk.live_picture
        return job is not None and not job.end_requested and self._desk.follower.command_folder is not None

    def _lit_by(self, news_age_s: float) -> str:
        follower = self._desk.follower
        if self._has_picture:
            return "the live picture"
        is_measuring = follower.running and follower.state.get("phase") == Phase.MEASURING
        has_laser = follower.safety.laser is not None
        return "the session" if is_measuring and has_laser and news_age_s < 1.0 else ""

    def _start_alarms(self) -> Iterator[RaisedAlarm]:
        """The alarm of a session of this desk that has failed before it could be followed."""
        start = self._desk.last_start
        if start is None or not self._desk.start_failed or start is self._judged_start:
            return
        self._judged_start = start
        with suppress(RigError):
            if state_of(read_session(start.folder)) is not None:
                # the follower has raised the alarm of its end
                return
        yield AlarmKey.SESSION_FAILED, f"{start.folder.name}: {self._desk.start_problem}"
