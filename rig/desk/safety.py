"""The rig's safety state as every tab shows it: from whoever has the devices, else from the rig's file.

What was confirmed last is kept with its time, so that a bar without news still states a fact.
"""

import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

from processing.errors import RigError
from rig.control import STALE_S, LatchedTrip, Light, Loop, SafetyNow, SafetyState
from rig.desk.aligner import Aligner
from rig.desk.following import Following
from rig.orders import Line, NoSession, SessionBusy

_READ_S = 0.25
_CONFIRMED = (Light.ON, Light.OFF, Light.INTERLOCK_OPEN)
"""What a device has said itself; all others are silence."""


@dataclass(frozen=True, slots=True)
class Confirmed:
    """The last state that somebody has confirmed: which one, at what time of the day in s, and who."""

    state: Light | Loop
    at_s: float
    by: str


class Safety:
    """Who has the devices is asked; a trip also holds when nobody has them any more.

    The file of a rig is read by a thread of this class. A rig without one (simulated) is remembered here as
    long as the desk lives: `unfiled` is its latch, None where a file has it. `by` is the device that says
    whether there is light; `light` and `interlock` are what was confirmed last, None before.
    """

    def __init__(
        self, rig: SafetyState, following: Following, aligner: Callable[[], Aligner | None], by: str
    ) -> None:
        self._rig, self._following, self._aligner, self._by = rig, following, aligner, by
        self.light: Confirmed | None = None
        self.interlock: Confirmed | None = None
        self.unfiled = rig if rig.path is None else None
        self._ended = threading.Event()
        self._of_command: tuple[SafetyNow, float] | None = None

    def start(self) -> None:
        """Begin to read, and to ask."""
        threading.Thread(target=self._read, name="rig's state", daemon=True).start()
        if self.unfiled is None:
            threading.Thread(target=self._ask, name="who has the rig", daemon=True).start()

    def stop(self) -> None:
        """Read no more."""
        self._ended.set()

    @property
    def now(self) -> SafetyNow:
        """What is known, with its ages now; never blocks."""
        aligner = self._aligner()
        own = None if aligner is None else aligner.safety
        if own is not None:
            return own
        following = self._following
        if following.running and following.news:
            told, heard_s = following.safety, following.heard_s
        elif (of_command := self._of_command) is not None:
            told, heard_s = of_command
        else:
            return SafetyNow(trip=self._rig.trip)
        since_s = time.monotonic() - heard_s
        return replace(
            told,
            trip=told.trip or (None if self.unfiled is not None else self._rig.trip),
            light_age_s=told.light_age_s + since_s,
            interlock_age_s=told.interlock_age_s + since_s,
        )

    @property
    def trip(self) -> LatchedTrip | None:
        """The trip that waits for its acknowledgement."""
        return self.now.trip

    def confirm(self, now: SafetyNow) -> None:
        """Keep what is confirmed at this moment."""
        at_s = time.time()
        if now.light in _CONFIRMED and now.light_age_s <= STALE_S:
            agrees = now.seen is (now.light is Light.ON) and now.seen_age_s <= STALE_S
            by = f"{self._by} and camera" if agrees else self._by
            self.light = Confirmed(now.light, at_s - now.light_age_s, by)
        if now.interlock is not Loop.UNKNOWN and now.interlock_age_s <= STALE_S:
            self.interlock = Confirmed(now.interlock, at_s - now.interlock_age_s, self._by)

    def _read(self) -> None:
        latched: LatchedTrip | None = None
        while not self._ended.wait(_READ_S):
            self.confirm(self.now)
            if self.unfiled is None:
                with suppress(RigError):
                    self._rig.read()
                continue
            # the latch of a simulated rig ends with the session's process, a real one's does not
            if self._following.running:
                latched = self._following.safety.trip
            elif latched is not None:
                self._rig.latch(latched.cause, latched.why, latched.lit)
                latched = None

    def _ask(self) -> None:
        """Ask the command that has the rig, and is no session, how its light stands."""
        while not self._ended.wait(_READ_S):
            folder = None if self._following.running else self._rig.folder_of_holder
            try:
                if folder is None:
                    self._of_command = None
                    continue
                with Line(folder) as line:
                    self._of_command = SafetyNow.told(line.news()["safety"]), time.monotonic()
            except SessionBusy:
                # what it said last grows older
                continue
            except (NoSession, KeyError, ValueError):
                self._of_command = None


def refusal(safety: SafetyNow) -> str:
    """Why a trip cannot be acknowledged yet, as the devices would say; empty where they do not refuse."""
    is_open = safety.interlock is Loop.OPEN and safety.interlock_age_s <= STALE_S
    return "close the interlock first" if is_open else ""


_KINDS = {Light.ON: "caution", Light.OFF: "go", Light.INTERLOCK_OPEN: "no", Light.DISAGREES: "no"}
_LOOPS = {Loop.CLOSED: "go", Loop.OPEN: "no"}


def lamps(safety: Safety, recording: str) -> dict[str, Mapping[str, object]]:
    """What the bar shows: for each lamp its text, its kind and its age in s, None for what was never heard.

    `recording` is empty where nothing is recorded. The page itself lets them grow older; what is too old
    gives way to `last`, what was confirmed last, whose age is `last_age_s`. `more` holds in any case.
    """
    now = safety.now
    laser = _lamp(now.light, _KINDS.get(now.light, "unknown"), now.light_age_s)
    interlock = _lamp(now.interlock, _LOOPS.get(now.interlock, "unknown"), now.interlock_age_s)
    forbidden = "light forbidden until acknowledged" if now.trip is not None else now.refusal
    return {
        "laser": {**laser, **_last(safety.light), "more": forbidden},
        "interlock": {**interlock, **_last_loop(safety.interlock)},
        "recording": _lamp(recording or "nothing", "caution" if recording else "dim", 0.0),
    }


def _lamp(text: str, kind: str, age_s: float) -> Mapping[str, object]:
    return {"text": text, "kind": kind, "age_s": round(age_s, 2) if math.isfinite(age_s) else None}


def _last_loop(confirmed: Confirmed | None) -> Mapping[str, object]:
    """`closed at 05:48:36`."""
    return {} if confirmed is None else {"last": f"{confirmed.state} at {_clock(confirmed.at_s)}"}


def _clock(at_s: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(at_s))


def _last(confirmed: Confirmed | None) -> Mapping[str, object]:
    """`off, confirmed 05:48:36 by board and camera`; light that was on may be off by now."""
    if confirmed is None:
        return {}
    said = f"confirmed {_clock(confirmed.at_s)} by {confirmed.by}"
    is_on = confirmed.state is Light.ON
    text = f"unknown; on, {said}" if is_on else f"{confirmed.state}, {said}"
    return {"last": text, "last_age_s": round(time.time() - confirmed.at_s, 1)}
