"""Light at the desk: everything dark at once, a trip that is acknowledged, and light again by a person."""

import math
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from processing.errors import RigError
from rig.control import (
    STALE_S,
    LatchedTrip,
    Light,
    Loop,
    SafetyNow,
    SafetyState,
    run_in_thread,
)
from rig.desk.following import Following
from rig.desk.run_reader import clock
from rig.devices import (
    MAX_ANSWER_S,
    ORDERS_NAME,
    SWITCHED_BY_HAND,
    Devices,
    LightOff,
)

if TYPE_CHECKING:
    from rig.desk.desk import Desk


_PRESSES_KEPT = 64
_FOUND_WITHIN_S = 0.5
"""Longest look for the order socket of a session on a disk that may hang."""
AT = "the desk"
"""Place of the press, in the text of a trip."""


def _takes_orders(folder: Path) -> bool:
    """Whether the session in a folder takes orders; False where its disk hangs."""
    try:
        return run_in_thread((folder / ORDERS_NAME).exists).result(_FOUND_WITHIN_S)
    except TimeoutError:
        return False


class Lighting:
    """Light of all that lights at a desk: live picture, followed session, started commands."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self._pressing = threading.Lock()
        self._pressed: dict[str, Future[list[str]]] = {}

    def off(self, press: str = "") -> list[str]:
        """Switch everything off, whichever program has lit it; returns what failed.

        The orders of `LightOff`, and those to what this desk runs. The same `press` arrives in two ways:
        the later one must not darken a laser that a person has acknowledged and lit again meanwhile, and
        returns the result of the first one.
        """
        with self._pressing:
            first = self._pressed.get(press) if press else None
            reply: Future[list[str]] = first or Future()
            self._pressed[press] = reply
            while len(self._pressed) > _PRESSES_KEPT:
                self._pressed.pop(next(iter(self._pressed)))
        if first is None:
            try:
                reply.set_result(self._off())
            except Exception as error:
                reply.set_exception(error)
        return reply.result(2.0 * MAX_ANSWER_S)

    def _off(self) -> list[str]:
        desk = self._desk
        folders = {folder for folder in (desk.following.folder,) if folder is not None}
        begun = desk.started
        if begun is not None and begun[0].poll() is not None:
            begun = None
        if begun is not None:
            folders.add(begun[1])
        picture = None if desk.following.held is None else desk.live_picture
        if picture is not None:
            folders.add(desk.config.session.output)
        pressed = LightOff(desk.config, desk.rig, AT, folders)
        # a live picture that answers lives on in the dark
        ended = [job for _, job in desk.jobs.running(uses_camera=True) if job is not picture]
        for job in ended:
            job.end()
        heard = bool(ended)
        if begun is not None and desk.following.last_folder != begun[1] and not _takes_orders(begun[1]):
            # it cannot take an order yet; a session that was followed and is gone is being fitted
            begun[0].terminate()
            heard = True
        problems, answered, kept = pressed.result()
        heard = heard or answered
        if desk.config.laser.kind == "none":
            problems.append(SWITCHED_BY_HAND)
        elif not heard:
            is_stored = kept and desk.rig.presses is not None
            stored = ": it is kept, and nothing is lit until it is acknowledged" if is_stored else ""
            problems.append(f"no program that could light has answered{stored}")
        return problems

    def acknowledge(self, number: int) -> str:
        """Acknowledge a trip for a person who has checked that the beam path is free; lights nothing.

        Raises RigError if the trip cannot be acknowledged. May wait.
        """
        desk = self._desk
        if desk.following.news:
            return desk.following.order(f"acknowledge {number}")
        with Devices(desk.config, desk.config.session.output, "the desk") as devices:
            devices.wait_for_reports()
            return devices.acknowledge(number, "the desk")

    def again(self) -> str:
        """Ask the live picture or the session to light again; RigError if neither runs. May wait."""
        return self._desk.following.order("light")

    @property
    def waits(self) -> bool:
        """Whether a session or live picture is dark and waits for a person to light it again."""
        shown, now = self._desk.shown, self._desk.safety.now
        if shown is None or now.trip is not None:
            return False
        if shown.running:
            # between two runs, too
            return now.needs_request or bool(shown.news.get("darkness") and shown.state.get("alarm"))
        return bool(shown.state.get("dark"))


_READ_S = 0.25
_CONFIRMED = (Light.ON, Light.OFF, Light.INTERLOCK_OPEN)
"""States that a device has reported itself; the others mean that it is silent."""


@dataclass(frozen=True, slots=True)
class ConfirmedState:
    """A confirmed state of light or interlock, its time of day in s, and the devices that confirmed it."""

    state: Light | Loop
    at_s: float
    by: str


class Safety:
    """The safety state of the rig, by the program that has its devices and by the rig's state on disk.

    A trip on disk holds also while no program has the devices. A thread of this class reads the file; a
    simulated rig has none, and its trip ends with the program that has it. `by` is the device that reports
    the light; `light` and `interlock` are the last confirmed states, None before any.
    """

    def __init__(self, rig: SafetyState, following: Following, by: str) -> None:
        self._rig, self._following, self._by = rig, following, by
        self.light: ConfirmedState | None = None
        self.interlock: ConfirmedState | None = None
        self._ended = threading.Event()

    def start(self) -> None:
        """Start the thread that reads the rig's state."""
        threading.Thread(target=self._read, name="rig's state", daemon=True).start()

    def stop(self) -> None:
        """Stop the thread."""
        self._ended.set()

    @property
    def now(self) -> SafetyNow:
        """The present safety state, with present ages; never blocks."""
        following = self._following
        if not following.news.get("safety"):
            return SafetyNow(trip=self._rig.trip)
        state, since_s = following.safety, time.monotonic() - following.heard_s
        return replace(
            state,
            trip=state.trip or self._rig.trip,
            light_age_s=state.light_age_s + since_s,
            interlock_age_s=state.interlock_age_s + since_s,
        )

    @property
    def trip(self) -> LatchedTrip | None:
        """The trip that waits for its acknowledgement."""
        return self.now.trip

    def confirm(self, now: SafetyNow) -> None:
        """Store the states of light and interlock that are confirmed now."""
        at_s = time.time()
        if now.light in _CONFIRMED and now.light_age_s <= STALE_S:
            agrees = now.spot_visible is (now.light is Light.ON) and now.spot_age_s <= STALE_S
            by = f"{self._by} and camera" if agrees else self._by
            self.light = ConfirmedState(now.light, at_s - now.light_age_s, by)
        if now.interlock is not Loop.UNKNOWN and now.interlock_age_s <= STALE_S:
            self.interlock = ConfirmedState(now.interlock, at_s - now.interlock_age_s, self._by)

    def _read(self) -> None:
        while not self._ended.wait(_READ_S):
            self.confirm(self.now)
            with suppress(RigError):
                self._rig.read()


def refusal(safety: SafetyNow) -> str:
    """Reason why the devices would refuse an acknowledgement now; empty if they would not."""
    is_open = safety.interlock is Loop.OPEN and safety.interlock_age_s <= STALE_S
    return "close the interlock first" if is_open else ""


_KINDS = {Light.ON: "caution", Light.OFF: "go", Light.INTERLOCK_OPEN: "no", Light.DISAGREES: "no"}
_LOOPS = {Loop.CLOSED: "go", Loop.OPEN: "no"}


def lamps(safety: Safety, recording: str) -> dict[str, Mapping[str, object]]:
    """Values of the lamps in the safety bar: text, kind and age in s, None for a state never reported.

    `recording` is empty where nothing is recorded. The page increases the ages itself. In the place of a
    state that is too old it shows `last`, the last confirmed one, whose age is `last_age_s`; `more` it always
    shows.
    """
    now = safety.now
    laser = _lamp(now.light, _KINDS.get(now.light, "unknown"), now.light_age_s)
    interlock = _lamp(now.interlock, _LOOPS.get(now.interlock, "unknown"), now.interlock_age_s)
    forbidden = "light forbidden until acknowledged" if now.trip is not None else now.refusal
    return {
        "laser": {**laser, **_last(safety.light), "more": forbidden},
        "interlock": {**interlock, **_last(safety.interlock)},
        "recording": _lamp(recording or "nothing", "caution" if recording else "dim", 0.0),
    }


def _lamp(text: str, kind: str, age_s: float) -> Mapping[str, object]:
    return {"text": text, "kind": kind, "age_s": round(age_s, 2) if math.isfinite(age_s) else None}


def _last(confirmed: ConfirmedState | None) -> Mapping[str, object]:
    """`off, confirmed 05:48:36 by board and camera`; a light that was on may be off by now."""
    if confirmed is None:
        return {}
    known = f"{confirmed.state}, confirmed {clock(confirmed.at_s)} by {confirmed.by}"
    text = f"unknown; {known}" if confirmed.state is Light.ON else known
    return {"last": text, "last_age_s": round(time.time() - confirmed.at_s, 1)}
