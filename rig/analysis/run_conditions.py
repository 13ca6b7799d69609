"""The conditions of a run as its record shows them: end, light, losses, beam, air, steps, ground, balance."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from acquisition.record.events import Event, EventKind, end_of
from acquisition.record.reader import RecordReader
from acquisition.record.topics import ENVIRONMENT
from processing.fit import Ground
from processing.spot import SpotFlag
from rig.analysis.beam import Beam
from rig.analysis.run_clock import RunClock, clock_verdict
from rig.presentation import Verdict, percent
from rig.settings import PreflightSettings

_MOST_KELVIN = 1.0
"""Of the air during a run: the paper's arm of 1 m of steel grows by 12 um, 2 arcsec, with each kelvin."""
_MOST_LEFT_OUT = 0.2
"""Of the half-cycles, which the ground moved too much to be fitted."""
_STEPS = {
    EventKind.LASER_DARK: (
        "light",
        "nothing confirmed that the laser was lit",
        "see the events; interlock, controller, cable",
    ),
    EventKind.REST_STEP: ("rest position", "it stepped", "find what touched the rig; measure again"),
    EventKind.PUSH: ("draught", "the swing was pushed", "shield the rig from air; keep away from it"),
    EventKind.LIGHT_STEP: ("ambient light", "it stepped", "keep the room dark; shield the sensor"),
}


def run_conditions(
    reader: RecordReader,
    frames: int,
    lost_spots: int,
    dropped_frames: int,
    limits: PreflightSettings,
    ground: Ground | None = None,
    half_cycles: int = 0,
    beam: Beam | None = None,
    clock: RunClock | None = None,
    balance: Sequence[Verdict] = (),
) -> tuple[Verdict, ...]:
    """One verdict for each condition; a record of a version that knew less has fewer events to go by.

    Frames that were dropped cost what lost spots cost: the limit of both is the preflight's of lost spots.
    """
    return (
        _end(end_of(reader.events())),
        _fraction("lost spots", lost_spots, frames, limits.max_lost_fraction, "see laser, beam and exposure"),
        _fraction(
            "dropped frames",
            dropped_frames,
            frames + dropped_frames,
            limits.max_lost_fraction,
            "find out where they were lost: camera, bus or computer",
        ),
        *([] if beam is None else [beam.verdict(limits.max_poor_fit_fraction)]),
        *([] if beam is None else [_saturation(beam, frames, limits.max_saturated_fraction)]),
        *_steps(reader.events()),
        *([] if clock is None else [clock_verdict(clock)]),
        *_watching(reader.events()),
        *_temperature(reader),
        *_ground(ground, half_cycles),
        *balance,
    )


def _end(end: Event | None) -> Verdict:
    """Whether the run came to its end; a person may end one early, and fit what there is."""
    if end is None or end.kind == EventKind.FAILED:
        reason = "the record has no end event" if end is None else "an error ended it"
        remedy = "remove the cause, then measure again: rig run --resume"
        measured = "none" if end is None else end.text
        return Verdict("end", False, reason, remedy, measured=measured, limit="its own")
    early = "ended early" if end.kind == EventKind.STOPPED else ""
    return Verdict("end", True, early, measured=end.text, limit="its own")


def _fraction(name: str, count: int, of: int, most: float, remedy: str) -> Verdict:
    part = count / of if of else 0.0
    ok = part <= most
    return Verdict(
        name,
        ok,
        "" if ok else "too many",
        "" if ok else remedy,
        measured=f"{count} of {of} ({percent(part)})",
        limit=f"{100 * most:g} %",
    )


def _saturation(beam: Beam, frames: int, most: float) -> Verdict:
    """A warning: the flanks of such spots alone are fitted, which only of a Gaussian beam say where it is."""
    found = _fraction(
        "saturation",
        beam.flags.get(SpotFlag.SATURATED.name or "", 0),
        frames,
        most,
        "lower the exposure (exposure_us) or the laser's power",
    )
    return replace(found, ok=True, reason="" if found.ok else "pixels at full scale are lost to the fit")


def _steps(events: Sequence[Event]) -> list[Verdict]:
    unlit = EventKind.LASER_DARK
    events = [one._replace(kind=unlit) if one.kind == EventKind.LASER_UNKNOWN else one for one in events]
    happened = Counter(event.kind for event in events)
    texts = {event.kind: event.text for event in reversed(events)}
    return [
        Verdict(
            name,
            not happened[kind],
            f"{reason}: {texts[kind]}" if happened[kind] else "",
            remedy if happened[kind] else "",
            measured={0: "never", 1: "once"}.get(happened[kind], f"{happened[kind]} times"),
            limit="never",
        )
        for kind, (name, reason, remedy) in _STEPS.items()
    ]


def _watching(events: Sequence[Event]) -> list[Verdict]:
    """A warning: what only watched has failed, which the record does not suffer from."""
    texts = [event.text for event in events if event.kind == EventKind.WATCHER_FAILED]
    if not texts:
        return []
    remedy = "the record is whole; report this with the program's log"
    return [Verdict("watching", True, "what only watches failed", remedy, measured=texts[-1], limit="never")]


def _temperature(reader: RecordReader) -> list[Verdict]:
    table = reader.table(ENVIRONMENT.topic)
    read_c = table["temperature_c"][np.isfinite(table["temperature_c"])] if len(table) else np.empty(0)
    if not len(read_c):
        return []
    spread = float(np.ptp(read_c))
    ok = spread <= _MOST_KELVIN
    return [
        Verdict(
            "temperature",
            ok,
            "" if ok else "it changed during the run",
            "" if ok else "wait until the room is steady; shield the rig",
            measured=f"{np.min(read_c):.2f} to {np.max(read_c):.2f} °C",
            limit=f"within {_MOST_KELVIN:g} K",
        )
    ]


def _ground(ground: Ground | None, half_cycles: int) -> list[Verdict]:
    """Whether the ground, as the exact fit saw it, left most of the decay to be fitted."""
    if ground is None or not half_cycles:
        return []
    part = ground.left_out_half_cycles / (half_cycles + ground.left_out_half_cycles)
    ok = part <= _MOST_LEFT_OUT
    widest = max((value for value in ground.widening.values() if np.isfinite(value)), default=1.0)
    return [
        Verdict(
            "ground",
            ok,
            "" if ok else "it drove the pendulum more than friction braked it",
            "" if ok else "measure at a quieter time or place; end at a larger amplitude",
            measured=f"{percent(part)} of the half-cycles left out, uncertainties × {widest:.2g}",
            limit=f"{100 * _MOST_LEFT_OUT:g} % left out",
        )
    ]
