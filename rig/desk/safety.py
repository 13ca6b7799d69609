"""The rig's safety state as every tab shows it: from whoever has the devices, else from the rig's file."""

import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace

from processing.errors import RigError
from rig.control import STALE_S, LatchedTrip, Light, Loop, SafetyNow, SafetyState
from rig.desk.aligner import Aligner
from rig.desk.following import Following
from rig.orders import Line, NoSession, SessionBusy

_READ_S = 0.25


class Safety:
    """Who has the devices is asked; a trip also holds when nobody has them any more.

    The file of a rig is read by a thread of this class. A rig without one (simulated) is remembered here as
    long as the desk lives: `unfiled` is its latch, None where a file has it.
    """

    def __init__(self, rig: SafetyState, following: Following, aligner: Callable[[], Aligner | None]) -> None:
        self._rig, self._following, self._aligner = rig, following, aligner
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

    def _read(self) -> None:
        latched: LatchedTrip | None = None
        while not self._ended.wait(_READ_S):
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


def lamps(safety: SafetyNow, recording: str) -> dict[str, Mapping[str, object]]:
    """What the bar shows: for each lamp its text, its kind and its age in s, None for what was never heard.

    `recording` is empty where nothing is recorded. The page itself lets them grow older.
    """
    return {
        "laser": _lamp(safety.light, _KINDS.get(safety.light, "unknown"), safety.light_age_s),
        "interlock": _lamp(safety.interlock, _LOOPS.get(safety.interlock, "unknown"), safety.interlock_age_s),
        "recording": _lamp(recording or "nothing", "caution" if recording else "dim", 0.0),
    }


def _lamp(text: str, kind: str, age_s: float) -> Mapping[str, object]:
    return {"text": text, "kind": kind, "age_s": round(age_s, 2) if math.isfinite(age_s) else None}
