"""Which alarms follow from what the desk sees; it looks ten times a second, and needs no page."""

import math
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from acquisition.frames.queue import taken_from
from acquisition.record.events import EventKind, Severity
from processing.errors import RigError
from rig.control import STALE_S, ControlState, LatchedTrip, Light, Loop, SafetyNow, TripCause
from rig.desk.alarm_list import AlarmKey, AlarmList, RaisedAlarm
from rig.instrument import Phase
from rig.measure import MIN_FREE_BYTES, read_session, state_of

if TYPE_CHECKING:
    from rig.desk.desk import Desk


_SPOT_S = 0.5
"""Shortest loss of the spot that is an alarm; a shorter one is data."""
_FRAMES_S = 1.5
_NEWS_S = 10.0
"""A busy machine makes the news of a sound session late by seconds, never by so much."""
_SILENT: Final = (Light.SILENT, Light.CONTROLLER_SILENT)
_WITH_FRAMES: Final = frozenset({Phase.REST, Phase.WARM_UP, Phase.RELEASE, Phase.MEASURING})
_OWN: Final[Mapping[str, AlarmKey]] = {
    EventKind.FAILED: AlarmKey.SESSION_FAILED,
    EventKind.RECORD: AlarmKey.DISK_FULL,
}
"""Events that are alarms of their own."""
_CONDITIONS: Final = frozenset({EventKind.ENDED_EARLY, EventKind.SPOT_LOST})
"""Warnings that a person gave, or that hold for as long as a condition does."""
_OF_DARKNESS: Final = frozenset({EventKind.LIGHT_STEP, EventKind.REST_STEP, EventKind.PUSH})
_UNDER_TRIP: Final = frozenset({AlarmKey.LASER_DARK, AlarmKey.SPOT, AlarmKey.BALANCE})
"""What frames without light look like; `_OF_DARKNESS` are events of the same."""


def conditions(
    safety: SafetyNow,
    news: Mapping[str, Any],
    *,
    session: str = "",
    news_age_s: float = 0.0,
    beat_age_s: float = math.inf,
    lit_by: str = "",
    sensor_wanted: bool = False,
    picture_late_s: float = 0.0,
) -> dict[AlarmKey, str]:
    """The alarms whose conditions hold, each with its cause.

    `news` is what the running `session` said `news_age_s` ago, empty without one, and `beat_age_s` how long
    ago it gave any sign of life; `lit_by` who has the laser; `picture_late_s` for how long the live picture
    has stood still. A press of LIGHT OFF is no alarm, and consequences of a trip are no alarms beside the
    trip, nor while a person who has acknowledged it has not asked for light.
    """
    found = dict(_light_alarms(safety, lit_by))
    state = news.get("state") or {}
    if news:
        if min(news_age_s, beat_age_s) > STALE_S:
            found[AlarmKey.SESSION_FROZEN] = f"{session} has said nothing for more than 2 s"
        elif news_age_s > _NEWS_S:
            found[AlarmKey.SESSION_FROZEN] = f"{session} answers, but has told nothing for {_NEWS_S:g} s"
        found |= _session_alarms(news, state, safety.light)
    if sensor_wanted and state.get("phase") == Phase.MEASURING and state.get("temperature_c") is None:
        found[AlarmKey.ENVIRONMENT] = "the sensor of the environment does not answer"
    if picture_late_s > STALE_S:
        found[AlarmKey.CAMERA] = "the live picture is frozen"
    tripped = safety.trip is not None or safety.to_be_asked
    under = _UNDER_TRIP if tripped else frozenset()
    return {key: cause for key, cause in found.items() if key not in under}


def happened(
    events: Iterable[Mapping[str, Any]], ends: Iterable[RaisedAlarm], trip: LatchedTrip | None = None
) -> list[RaisedAlarm]:
    """Alarms by a session's new warnings and its end; consequences of a `trip` are no alarms.

    A session that ends because somebody has pressed LIGHT OFF has not failed.
    """
    passed_over = _CONDITIONS if trip is None else _CONDITIONS | _OF_DARKNESS
    found = []
    for event in events:
        kind, text = str(event["kind"]), str(event["text"])
        if kind in _OWN:
            found.append((_OWN[kind], text))
        elif event["level"] == Severity.WARNING and kind not in passed_over:
            found.append((AlarmKey.DISTURBED, f"{kind}: {text}"))
    is_own = trip is not None and _is_own(trip)
    return [one for one in (*found, *ends) if not (is_own and one[0] is AlarmKey.SESSION_FAILED)]


def _is_own(trip: LatchedTrip) -> bool:
    """Whether a person has taken the light, who knows of it."""
    return trip.cause is TripCause.PERSON


def _light_alarms(safety: SafetyNow, lit_by: str) -> Iterator[RaisedAlarm]:
    if safety.trip is not None and not _is_own(safety.trip):
        yield AlarmKey.TRIP, safety.trip.text
    if safety.light is Light.DISAGREES:
        yield AlarmKey.LIGHT_DISAGREES, "the laser's output, or its light in the picture, is seen to be on"
    if safety.interlock is Loop.OPEN and safety.interlock_age_s <= STALE_S:
        yield AlarmKey.INTERLOCK, "a door, a cover or the connector of the loop is open"
    silent = safety.light in _SILENT
    unknown = silent or safety.light is Light.UNKNOWN or safety.light_age_s > STALE_S
    if lit_by and unknown and not math.isinf(safety.light_age_s):
        silence = str(safety.light) if silent else "nothing was heard of for more than 2 s"
        yield AlarmKey.LASER_UNKNOWN, f"{lit_by} has the laser, which {silence}"
    if safety.controller not in (None, ControlState.OPEN):
        yield AlarmKey.CONTROLLER, str(safety.controller)


def _session_alarms(news: Mapping[str, Any], state: Mapping[str, Any], light: Light) -> Iterator[RaisedAlarm]:
    crying = str(state.get("alarm") or "")
    if float(state.get("disk_silent_s") or 0.0):
        yield AlarmKey.DISK_HANGS, "a write to the record takes more than 2 s"
    elif crying:
        dark = AlarmKey.LASER_UNKNOWN if light in _SILENT else AlarmKey.LASER_DARK
        yield (dark if news.get("darkness") else AlarmKey.STALLED), crying
    if state.get("phase") in _WITH_FRAMES:
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
    patience_s = max(_FRAMES_S, 3.0 / float(rate_hz)) if rate_hz else _FRAMES_S
    if float(news.get("frames_age_s") or 0.0) > patience_s:
        yield AlarmKey.CAMERA, f"none for more than {patience_s:.2g} s"
    elif float(news.get("spot_lost_s") or 0.0) > _SPOT_S:
        yield AlarmKey.SPOT, "the beam is blocked or misses the sensor, or the swing is too large"


def _disk_alarms(state: Mapping[str, Any]) -> Iterator[RaisedAlarm]:
    left_s, free_bytes, rate = (
        state.get(key) for key in ("remaining_s", "disk_free_bytes", "record_bytes_per_s")
    )
    if free_bytes is not None and rate:
        lasts_s = max(float(free_bytes) - MIN_FREE_BYTES, 0.0) / float(rate)
        needed_s = float(left_s) if left_s is not None else float(state.get("at_most_s") or 0.0)
        if lasts_s < needed_s and math.isfinite(needed_s):
            yield (
                AlarmKey.DISK_FORECAST,
                f"room for {lasts_s / 60:.0f} min, needed for {needed_s / 60:.0f} min",
            )


_LOOK_S = 0.1


class Alarming:
    """The alarms of a desk: `alarms` is their list."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self.alarms = AlarmList()
        self._ended = threading.Event()
        self._was_running = False
        self._trip: LatchedTrip | None = None
        self._begun: object = None

    def start(self) -> None:
        """Begin to look."""
        threading.Thread(target=self._look_repeatedly, name="alarms", daemon=True).start()

    def stop(self) -> None:
        """Look no more."""
        self._ended.set()

    def _look_repeatedly(self) -> None:
        while not self._ended.is_set():
            try:
                self._look()
            except Exception as error:
                # an alarm that cannot be judged is one
                self.alarms.see({}, [(AlarmKey.WATCHER, f"the desk's own watch: {error}")])
            self._ended.wait(_LOOK_S)

    def _look(self) -> None:
        following = self._desk.following
        was_running, self._was_running = self._was_running, following.running
        if self._was_running and not was_running:
            self.alarms.session_begins()
        # the end of a session is seen before the latch of a rig that ends with it
        trip, self._trip = self._desk.safety.trip or self._trip, self._desk.safety.trip
        events = taken_from(following.unheard)
        ends = [*taken_from(following.ended), *self._start_alarms()]
        news = following.news if following.running else {}
        age_s = time.monotonic() - following.heard_s if news else 0.0
        holding = conditions(
            self._desk.safety.now,
            news,
            session="" if following.folder is None else following.folder.name,
            news_age_s=age_s,
            beat_age_s=time.monotonic() - following.beat_s,
            lit_by=self._lit_by(age_s),
            sensor_wanted=self._desk.config.environment_sensor.kind != "none",
            picture_late_s=following.frames_age_s if self._has_picture else 0.0,
        )
        self.alarms.see(holding, happened(events, ends, trip))

    @property
    def _has_picture(self) -> bool:
        """Whether a live picture has told of itself, and nobody has ended it: then it may stand still."""
        picture = self._desk.live_picture
        return picture is not None and not picture.ending and self._desk.following.held is not None

    def _lit_by(self, news_age_s: float) -> str:
        following = self._desk.following
        if self._has_picture:
            return "the live picture"
        measures = following.state.get("phase") == Phase.MEASURING
        has_laser = following.safety.laser is not None
        return "the session" if following.running and measures and has_laser and news_age_s < 1.0 else ""

    def _start_alarms(self) -> Iterator[RaisedAlarm]:
        """A session of this desk that has ended with an error before it could be followed."""
        begun = self._desk.started
        if begun is None or begun[0].poll() in (None, 0) or begun[0] is self._begun:
            return
        self._begun, folder = begun[0], begun[1]
        with suppress(RigError):
            if state_of(read_session(folder)) is not None:
                # what the file says was told when it ended
                return
        yield AlarmKey.SESSION_FAILED, f"{folder.name}: {self._desk.start_problem}"
