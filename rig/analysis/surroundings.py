"""What surrounded a run: the air, and how long the contact and its surfaces had been as they were."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from datetime import datetime
from math import nan

import numpy as np

from acquisition.record.reader import RecordReader
from acquisition.record.topics import ENVIRONMENT, SPOT
from acquisition.record.utc import utc
from processing.air import humid_air
from processing.contact import ExpectedDrag, PendulumOnBall, bar_of, expected_drag_s
from processing.surroundings import Surroundings, doubtful_humidity
from rig.settings import Configuration

_AIR = ("temperature_c", "humidity_percent", "pressure_pa")
_USUAL = {"temperature_c": 20.0, "humidity_percent": 50.0, "pressure_pa": 101325.0}
_FEWEST = 4
"""Fewest readings that show a change."""
_SINCE = {"dwell_s": "contact_made", "age_s": "surfaces_cleaned"}


def stated_surroundings(config: Configuration) -> Surroundings:
    """The air as the user stated it."""
    stated = {name: getattr(config.environment, name) for name in type(config.environment).model_fields}
    return Surroundings(**{name: float(value) for name, value in stated.items() if value is not None})


def surroundings_of_table(config: Configuration, began_s: float | None) -> Surroundings:
    """As stated, with the history of the contact up to the first row, if that is a time since 1970."""
    since = {name: getattr(config.session, key) for name, key in _SINCE.items()}
    known = {} if began_s is None else {name: began_s - at.timestamp() for name, at in since.items() if at}
    return replace(stated_surroundings(config), **known)


def recorded_surroundings(reader: RecordReader, config: Configuration | None = None) -> Surroundings:
    """Those of a record; what is stated comes from `config`, or without one from the record's own texts."""
    if config is None:
        air = {name: _number(text) for name, text in reader.metadata.get("environment", {}).items()}
        session = reader.metadata.get("session", {})
        times = {name: session.get(key, "") for name, key in _SINCE.items()}
    else:
        air = asdict(stated_surroundings(config))
        stated = {name: getattr(config.session, key) for name, key in _SINCE.items()}
        times = {name: at.isoformat() if at is not None else "" for name, at in stated.items()}
    return Surroundings(**_read(reader, air), **_since(reader, times))


def _read(reader: RecordReader, stated: Mapping[str, float]) -> dict[str, float]:
    table = reader.table(ENVIRONMENT.topic)
    found = {}
    for name in _AIR:
        readings = table[name] if len(table) else np.empty(0)
        read = readings[np.isfinite(readings)]
        found[name] = float(np.mean(read)) if len(read) else stated.get(name, nan)
        if name == "temperature_c" and len(read) >= _FEWEST:
            at = np.linspace(-0.5, 0.5, len(read))
            found["temperature_change_k"] = float(np.polyfit(at, read, 1)[0])
    return found


def _since(reader: RecordReader, times: Mapping[str, str]) -> dict[str, float]:
    stated = {name: datetime.fromisoformat(text) for name, text in times.items() if text}
    first = next(iter(reader.messages(SPOT.topic)), None) if stated else None
    # the log time is UTC already
    return (
        {}
        if first is None
        else {name: (utc(first.log_time_ns) - since).total_seconds() for name, since in stated.items()}
    )


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return nan


def doubts_of(found: Surroundings) -> list[str]:
    """Times that the configuration states and that cannot be, and a humidity that was hardly meant."""
    said = [doubtful_humidity(found.humidity_percent)]
    return [*filter(None, said)] + [
        f"session.{key} lies {-getattr(found, name):.0f} s after the run began: correct its date or offset"
        for name, key in _SINCE.items()
        if getattr(found, name) < 0
    ]


def expected_drag(
    found: Surroundings, pendulum: PendulumOnBall, period_s: float, config: Configuration
) -> ExpectedDrag:
    """The drag that this air, or a usual one where it is not known, gives a bar in the pendulum's place."""
    air = humid_air(**{**_USUAL, **{name: value for name, value in found.known().items() if name in _AIR}})
    stated = config.pendulum
    length, width = (None, None) if stated is None else (stated.length_m, stated.width_m)
    bar = bar_of(pendulum, period_s, length, width)
    return ExpectedDrag(
        drag_s=expected_drag_s(air, bar, pendulum, period_s),
        air_density_kg_per_m3=air.density_kg_per_m3,
        air_viscosity_pa_s=air.viscosity_pa_s,
        length_m=bar.length_m,
        width_m=bar.width_m,
        assumed=tuple(name for name in _AIR if name not in found.known())
        + tuple(name for name, value in (("length_m", length), ("width_m", width)) if value is None),
    )
