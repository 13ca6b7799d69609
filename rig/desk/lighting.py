"""Light at the desk: LIGHT OFF, acknowledgement of a trip, light again by a person, and the state shown."""

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
from rig.control import STALE_S, LatchedTrip, Light, Loop, SafetyNow, SafetyState, run_in_thread
from rig.desk.follower import RigFollower
from rig.desk.run_reader import clock
from rig.devices import MAX_ANSWER_S, ORDERS_NAME, SWITCHED_BY_HAND, Devices, LightOff

if TYPE_CHECKING:
    from rig.desk.desk import Desk


_MAX_PRESSES = 64
_MAX_LOOK_S = 0.5
"""Longest look for the order socket of a session on a disk that may hang."""
_DESK = "the desk"
"""Where LIGHT OFF was pressed, in the text of a trip, and who acknowledges it."""


def _takes_orders(folder: Path) -> bool:
    """Whether the session in a folder takes orders; False if its disk hangs."""
    try:
        return run_in_thread((folder / ORDERS_NAME).exists).result(_MAX_LOOK_S)
    except TimeoutError:
        return False


class Lighting:
    """Light of all programs at a desk that light: live picture, followed session, started commands."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self._lock = threading.Lock()
        self._replies: dict[str, Future[list[str]]] = {}

    def off(self, press: str = "") -> list[str]:
        """Switch everything off, whichever program has lit it; returns what failed.

        The page sends each press by two ways: the later request must not darken a laser that a person has
        acknowledged and lit again meanwhile, and returns the result of the first.
        """
        with self._lock:
            first = self._replies.get(press) if press else None
            reply: Future[list[str]] = first or Future()
            self._replies[press] = reply
            while len(self._replies) > _MAX_PRESSES:
                self._replies.pop(next(iter(self._replies)))
        if first is None:
            try:
                reply.set_result(self._off())
            except Exception as error:
                reply.set_exception(error)
        return reply.result(2.0 * MAX_ANSWER_S)

    def _off(self) -> list[str]:
        desk, follower = self._desk, self._desk.follower
        start = desk.last_start if desk.start_runs else None
        picture = None if follower.command_folder is None else desk.live_picture
        folders = [] if follower.folder is None else [follower.folder]
        folders += [] if start is None else [start.folder]
        folders += [] if picture is None else [desk.config.session.output]
        light_off = LightOff(desk.config, desk.rig_state, _DESK, folders)
        # a live picture that answers goes on in the dark
        jobs = [job for _, job in desk.jobs.running(uses_camera=True) if job is not picture]
        for job in jobs:
            job.end()
        is_heard = bool(jobs)
        if start is not None and follower.last_folder != start.folder and not _takes_orders(start.folder):
            # it cannot take an order yet; a session that was followed and is gone is being fitted
            start.process.terminate()
            is_heard = True
        problems, is_answered, is_kept = light_off.result()
        if desk.config.laser.kind == "none":
            problems.append(SWITCHED_BY_HAND)
        elif not (is_heard or is_answered):
            is_stored = is_kept and desk.rig_state.presses is not None
            stored = ": it is kept, and nothing is lit until it is acknowledged" if is_stored else ""
            problems.append(f"no program that could light has answered{stored}")
        return problems

    def acknowledge(self, number: int) -> str:
        """Acknowledge a trip for a person who has checked that the beam path is free; lights nothing.

        Raises RigError if the trip cannot be acknowledged. May wait.
        """
        desk = self._desk
        if desk.follower.news:
            return desk.follower.order(f"acknowledge {number}")
        with Devices(desk.config, desk.config.session.output, _DESK) as devices:
            devices.wait_for_reports()
            return devices.acknowledge(number, _DESK)

    def relight(self) -> str:
        """Ask the live picture or the session to light again; RigError if neither runs. May wait."""
        return self._desk.follower.order("light")

    @property
    def awaits_light(self) -> bool:
        """Whether a session or live picture is dark and waits for a person to light it again."""
        source, now = self._desk.picture_source, self._desk.safety.now
        if source is None or now.trip is not None:
            return False
        if source.running:
            # also between two runs
            return now.needs_request or bool(source.news.get("darkness") and source.state.get("alarm"))
        return bool(source.state.get("dark"))


_READ_INTERVAL_S = 0.25
_CONFIRMED = (Light.ON, Light.OFF, Light.INTERLOCK_OPEN)
"""States that a device has reported itself; the others mean that it is silent."""


@dataclass(frozen=True, slots=True)
class ConfirmedState:
    """A confirmed state of light or interlock, its time of day in s, and the devices that confirmed it."""

    state: Light | Loop
    time_s: float
    devices: str


class Safety:
    """The safety state of the rig, by the program that has its devices and by the rig's state on disk.

    A trip on disk is latched also while no program has the devices. A thread of this class reads the file; a
    simulated rig has no file, and its trip ends with the program that has it. `device` is the name of the
    device that reports the light; `light` and `interlock` are the last confirmed states, None before any.
    """

    def __init__(self, rig_state: SafetyState, follower: RigFollower, device: str) -> None:
        self._rig_state, self._follower, self._device = rig_state, follower, device
        self.light: ConfirmedState | None = None
        self.interlock: ConfirmedState | None = None
        self._stop = threading.Event()

    def start(self) -> None:
        threading.Thread(target=self._read, name="rig's state", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    @property
    def now(self) -> SafetyNow:
        """The present safety state, with present ages; never blocks."""
        follower = self._follower
        if not follower.news.get("safety"):
            return SafetyNow(trip=self._rig_state.trip)
        state, news_age_s = follower.safety, time.monotonic() - follower.news_s
        return replace(
            state,
            trip=state.trip or self._rig_state.trip,
            light_age_s=state.light_age_s + news_age_s,
            interlock_age_s=state.interlock_age_s + news_age_s,
        )

    @property
    def trip(self) -> LatchedTrip | None:
        """The trip that waits for its acknowledgement."""
        return self.now.trip

    def confirm(self, now: SafetyNow) -> None:
        """Store the states of light and interlock that are confirmed now."""
        time_s = time.time()
        if now.light in _CONFIRMED and now.light_age_s <= STALE_S:
            camera_agrees = now.spot_visible is (now.light is Light.ON) and now.spot_age_s <= STALE_S
            devices = f"{self._device} and camera" if camera_agrees else self._device
            self.light = ConfirmedState(now.light, time_s - now.light_age_s, devices)
        if now.interlock is not Loop.UNKNOWN and now.interlock_age_s <= STALE_S:
            self.interlock = ConfirmedState(now.interlock, time_s - now.interlock_age_s, self._device)

    def _read(self) -> None:
        while not self._stop.wait(_READ_INTERVAL_S):
            self.confirm(self.now)
            with suppress(RigError):
                self._rig_state.read()


def refusal(safety: SafetyNow) -> str:
    """Reason why the devices would refuse an acknowledgement now; empty if they would not."""
    is_open = safety.interlock is Loop.OPEN and safety.interlock_age_s <= STALE_S
    return "close the interlock first" if is_open else ""


_LASER_KINDS = {Light.ON: "caution", Light.OFF: "go", Light.INTERLOCK_OPEN: "no", Light.DISAGREES: "no"}
_INTERLOCK_KINDS = {Loop.CLOSED: "go", Loop.OPEN: "no"}


def lamps(safety: Safety, recording: str) -> dict[str, Mapping[str, object]]:
    """Values of the lamps in the safety bar: text, kind and age in s, None for a state never reported.

    `recording` is empty while nothing is recorded. The page increases the ages itself. Instead of a state
    that is too old it shows `last`, the last confirmed state, whose age is `last_age_s`. It always shows the
    text `more`.
    """
    now = safety.now
    laser = _lamp(now.light, _LASER_KINDS.get(now.light, "unknown"), now.light_age_s)
    interlock = _lamp(now.interlock, _INTERLOCK_KINDS.get(now.interlock, "unknown"), now.interlock_age_s)
    refused = "light forbidden until acknowledged" if now.trip is not None else now.refusal
    return {
        "laser": {**laser, **_last(safety.light), "more": refused},
        "interlock": {**interlock, **_last(safety.interlock)},
        "recording": _lamp(recording or "nothing", "caution" if recording else "dim", 0.0),
    }


def _lamp(text: str, kind: str, age_s: float) -> Mapping[str, object]:
    return {"text": text, "kind": kind, "age_s": round(age_s, 2) if math.isfinite(age_s) else None}


def _last(confirmed: ConfirmedState | None) -> Mapping[str, object]:
    """A text such as `off, confirmed 05:48:36 by board and camera`, and the age of the state."""
    if confirmed is None:
        return {}
    text = f"{confirmed.state}, confirmed {clock(confirmed.time_s)} by {confirmed.devices}"
    # a light that was on may be off by now
    text = f"unknown; {text}" if confirmed.state is Light.ON else text
    return {"last": text, "last_age_s": round(time.time() - confirmed.time_s, 1)}
