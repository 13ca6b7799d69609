"""Orders to a running session, operators' notes, the wait for an acknowledgement, the judge of starts."""

import _thread
import json
import math
import os
import threading
import time
from collections import deque
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from acquisition.frames.queue import take_all
from processing.balance import Balance
from processing.deflections import DeflectionUnit
from processing.errors import RigError
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD
from rig.control import LightRefused
from rig.devices import (
    AuditEntry,
    Devices,
    Orders,
    SessionNews,
    ask_acknowledgement,
    at_terminal,
    light_orders,
    wait_for_command,
)
from rig.instrument import Phase
from rig.settings import Configuration

NOTES_NAME = "notes.jsonl"
_MAX_CHARACTERS = 2000


class OperatorNote(NamedTuple):
    """A note of an operator; `host_time_ns` is the time of the computer's monotonic clock."""

    host_time_ns: int
    author: str
    text: str


class Notes:
    """The notes of a session; `write` may be called by any thread, `take` by the thread of the run.

    Each note is saved in `notes.jsonl` in the session's folder before `write` returns, so that none is lost
    between runs, or with a run that is not recorded. `author` is the session's operator.
    """

    def __init__(self, folder: Path, author: str) -> None:
        self._path, self._author = folder / NOTES_NAME, author
        self._new_notes: deque[OperatorNote] = deque()
        self._write_lock = threading.Lock()

    def write(self, text: str) -> str:
        """Save a note; returns a confirmation. Raises RigError if it is empty, too long or not saved."""
        text, author = " ".join(text.split()), self._author
        if not text:
            raise RigError("an empty note: type some text")
        if len(text) > _MAX_CHARACTERS:
            raise RigError(f"a note of {len(text)} characters: at most {_MAX_CHARACTERS}; split it in two")
        note = OperatorNote(time.monotonic_ns(), author, text)
        utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"utc": utc, "author": author, "text": text}, ensure_ascii=False)
        with self._write_lock:
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(f"{line}\n")
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as error:
                raise RigError(f"{self._path}: the note cannot be kept: {error.strerror or error}") from None
            self._new_notes.append(note)
        return f"noted: {text}"

    def take(self) -> list[OperatorNote]:
        """The notes since the last call, oldest first."""
        return take_all(self._new_notes)


_CHECK_INTERVAL_S = 0.1


def orders(devices: Devices, notes: Notes, session_news: SessionNews) -> Orders:
    """The orders by name; `stop` acts like Ctrl-C.

    `brake on` is refused while a decay is recorded, because the brake would end it without a trace in the
    record.
    """

    def stop(_: str) -> str:
        _thread.interrupt_main()
        return "stopping: the record is being closed"

    def brake(value: str) -> str:
        if value not in ("on", "off"):
            raise RigError(f"brake {value!r}: should be on or off")
        on = value == "on"
        if on and session_news.phase == Phase.MEASURING:
            raise RigError("the brake would spoil the decay that is being recorded: stop the run first")
        wait_for_command(
            devices.required_control("the brake").submit(lambda controller: controller.brake(on))
        )
        devices.audit(AuditEntry.BRAKE, "ordered", on=on)
        return f"brake {value}"

    return {
        "stop": stop,
        "note": notes.write,
        "light": lambda _: relight(devices),
        "brake": brake,
        **light_orders(devices),
    }


def relight(devices: Devices) -> str:
    """Carry out a person's request for light, in a run that waits in the dark or for the next run.

    Nothing is lit while no frames are processed.
    """
    if (trip := devices.permit.latched) is not None:
        raise LightRefused(f"{trip.text}: acknowledge it first")
    if devices.permit.expects_light:
        return devices.light(on_request=True, in_run=True) or "the laser is lit already"
    if not devices.lights_again:
        raise LightRefused("no run follows that would light the laser; start one")
    devices.permit.request_light()
    return "the next run lights the laser"


def await_acknowledgement(devices: Devices, session_news: SessionNews, *, resumable: bool = True) -> None:
    """Wait after a trip until a person at the terminal or a desk has acknowledged it and asked for light.

    Raises LightRefused, with the remedy, if there is no such person. A session that is not `resumable` has no
    record yet.
    """
    ask_acknowledgement(devices)
    permit, trip = devices.permit, devices.permit.latched
    if (trip or permit.needs_request) and session_news.is_watched and not at_terminal():
        cause = "light is to be asked for" if trip is None else trip.text
        session_news.waits(f"{cause}: the next run waits for a person")
        while session_news.is_watched and (permit.latched or permit.needs_request):
            time.sleep(_CHECK_INTERVAL_S)
    if permit.latched or permit.needs_request:
        cause = "nobody has asked for light since the trip"
        remedy = "rig run --resume measures the missing runs" if resumable else "start the session again"
        if trip is not None:
            cause = f"{trip.text}, and nobody has acknowledged it"
            if devices.state.path is not None:
                remedy = f"{devices.remedy}, then {remedy}"
        raise LightRefused(f"{cause}; {remedy}")


_MIN_EXCESS_SIGMA = 2.0
"""Minimum excess of a rejected start's rotation over its limit, in standard uncertainties."""
_MIN_HALF_CYCLES = 2
"""Unflagged half-cycles by which the first amplitude is judged."""


class StartJudge:
    """Judges one start by its first two unflagged half-cycles and the balance of its first periods.

    The rotation is judged later, by the first balance that has its rate, five periods after the release.
    `first_amplitude` is the larger amplitude of these half-cycles, in `unit`, 0 before the first; in px it
    has no limits, because they are configured in arcsec. After `attempts` rejected starts a run fails.
    """

    def __init__(self, config: Configuration, unit: DeflectionUnit) -> None:
        self._start, self._unit = config.start, unit
        self.attempts = config.start.attempts
        self._max_spin_deg_per_min = config.balance.spin_deg_per_min
        self._min_amplitude, self._max_amplitude = 0.0, math.inf
        if unit is DeflectionUnit.RAD:
            target_rad = config.session.initial_amplitude_arcsec * ARCSEC_RAD
            self._min_amplitude = config.start.lowest_amplitude * target_rad
            self._max_amplitude = config.start.highest_amplitude * target_rad
        self._is_accepted = self._is_balance_judged = self._is_rotation_judged = False
        self._half_cycles = 0
        self.first_amplitude = 0.0

    def rejection(
        self, half_cycles: Sequence[HalfCycle], balances: Sequence[Balance], elapsed_s: float
    ) -> str:
        """Why the start is rejected; empty while the judgement is open and after the start was accepted."""
        return self._first_half_cycles_fault(half_cycles, balances, elapsed_s) or self._rotation_fault(
            balances
        )

    def _rotation_fault(self, balances: Sequence[Balance]) -> str:
        known = [balance for balance in balances if math.isfinite(balance.rotation_rad_per_s)]
        if self._is_rotation_judged or not known:
            return ""
        self._is_rotation_judged = True
        rate = 60.0 * math.degrees(known[0].rotation_rad_per_s)
        u, limit = 60.0 * math.degrees(known[0].u_rotation_rad_per_s), self._max_spin_deg_per_min
        if not abs(rate) - _MIN_EXCESS_SIGMA * u > limit:
            return ""
        return (
            f"the plane of swing turns by {rate:+.2f} deg/min, at most {limit:g} deg/min is allowed: "
            "let the pendulum settle before the release"
        )

    def _first_half_cycles_fault(
        self, half_cycles: Sequence[HalfCycle], balances: Sequence[Balance], elapsed_s: float
    ) -> str:
        if self._is_accepted:
            return ""
        for half_cycle in half_cycles:
            if not half_cycle.flags:
                self._half_cycles += 1
                self.first_amplitude = max(self.first_amplitude, half_cycle.amplitude)
        has_amplitude = self._half_cycles >= _MIN_HALF_CYCLES
        if has_amplitude and not self._min_amplitude <= self.first_amplitude <= self._max_amplitude:
            size, lowest, highest = self._unit.shown_size, self._min_amplitude, self._max_amplitude
            first = f"first amplitude {self.first_amplitude / size:.1f} {self._unit.shown}"
            return f"{first}, {lowest / size:.1f} to {highest / size:.1f} are required"
        limit, patience_s = self._start.max_transverse_ratio, self._start.patience_s
        for balance in balances:
            if balance.amplitude < 0.5 * self._min_amplitude:
                continue
            self._is_balance_judged = True
            if balance.transverse_ratio > limit:
                return (
                    f"transverse motion is {100 * balance.transverse_ratio:.1f} % of the swing, "
                    f"at most {100 * limit:.1f} % is allowed"
                )
        self._is_accepted = has_amplitude and self._is_balance_judged
        if not self._is_accepted and elapsed_s > patience_s:
            return f"no two clean half-cycles within {patience_s:g} s"
        return ""
