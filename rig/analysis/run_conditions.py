"""The conditions of a run as its record shows them: light, losses, temperature, steps."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from acquisition.record.events import Event, EventKind
from acquisition.record.reader import RecordReader
from acquisition.record.topics import ENVIRONMENT
from rig.presentation import Verdict
from rig.settings import PreflightSettings

_MOST_KELVIN = 1.0
"""Of the air during a run: the paper's arm of 1 m of steel grows by 12 um, 2 arcsec, with each kelvin."""
_STEPS = {
    EventKind.LASER_DARK: ("light", "the laser went dark", "see the events; interlock, controller, cable"),
    EventKind.REST_STEP: ("rest position", "it stepped", "find what touched the rig; measure again"),
    EventKind.LIGHT_STEP: ("ambient light", "it stepped", "keep the room dark; shield the sensor"),
}


def run_conditions(
    reader: RecordReader, frames: int, lost_spots: int, dropped_frames: int, limits: PreflightSettings
) -> tuple[Verdict, ...]:
    """One verdict for each condition; a record of a version that knew less has fewer events to go by.

    Frames that were dropped cost what lost spots cost: the limit of both is the preflight's of lost spots.
    """
    return (
        _fraction("lost spots", lost_spots, frames, limits.max_lost_fraction, "see laser, beam and exposure"),
        _fraction(
            "dropped frames",
            dropped_frames,
            frames + dropped_frames,
            limits.max_lost_fraction,
            "see who lost them: camera, bus or computer",
        ),
        *_steps(reader.events()),
        *_temperature(reader),
    )


def _fraction(name: str, count: int, of: int, most: float, remedy: str) -> Verdict:
    part = count / of if of else 0.0
    ok = part <= most
    return Verdict(
        name,
        ok,
        "" if ok else "too many",
        "" if ok else remedy,
        measured=f"{count} of {of} ({100 * part:.2g} %)",
        limit=f"{100 * most:g} %",
    )


def _steps(events: Sequence[Event]) -> list[Verdict]:
    happened = Counter(event.kind for event in events)
    texts = {event.kind: event.text for event in reversed(events)}
    return [
        Verdict(
            name,
            not happened[kind],
            f"{reason}: {texts[kind]}" if happened[kind] else "",
            remedy if happened[kind] else "",
            measured=f"{happened[kind]} times",
            limit="never",
        )
        for kind, (name, reason, remedy) in _STEPS.items()
    ]


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
