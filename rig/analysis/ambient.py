"""Ambient conditions of a run, the drag and drifts that follow from them, and its seismometer's record."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from acquisition.record.digest import utc
from acquisition.record.reader import RecordReader
from acquisition.record.topics import ENVIRONMENT, SEISMOMETER, SPOT
from processing.ambient import AmbientConditions, doubtful_humidity, humid_air
from processing.arrays import Floats
from processing.arrival_times import sample_times
from processing.contact import ExpectedDrag, PendulumOnBall, bar_of, expected_drag_s
from processing.estimate import Estimate
from processing.fit import Evidence, FitResult, InputQuantity, waveform_of
from processing.swing import PieceHarmonics
from rig.analysis.run_remarks import CLOCK_SET
from rig.instrument import balls
from rig.settings import Configuration
from rig.terminal import percent, quantity

if TYPE_CHECKING:
    from rig.intake import SeismometerRecord

_USUAL_AIR = {"temperature_c": 20.0, "humidity_percent": 50.0, "pressure_pa": 101325.0}
"""Air of a laboratory, assumed where a condition is not known."""
_BAR_SIZES = ("length_m", "width_m")
_MIN_READINGS = 4
"""Fewest readings that show a change."""
_MIN_SPAN = 0.5
"""Least part of a run that readings must span to show its change: from less it would be extrapolated."""
_HISTORY_KEYS = {"dwell_s": "contact_made", "age_s": "surfaces_cleaned"}
"""Keys of [session] whose times begin the contact's history."""


def stated_ambient(config: Configuration, began: datetime | None = None) -> AmbientConditions:
    """The ambient conditions that the configuration states; NaN where it states none.

    The history of the contact is that up to `began`, the beginning of the run, if it is known.
    """
    moments = {key: getattr(config.session, key) for key in _HISTORY_KEYS.values()}
    return _ambient(config.environment.model_dump(exclude_none=True), moments, began)


def recorded_ambient(reader: RecordReader, config: Configuration | None = None) -> AmbientConditions:
    """Ambient conditions of a record: its readings, else those that `config` states, or itself for None."""
    first = next(iter(reader.messages(SPOT.topic)), None)
    # the log time is UTC already
    began = None if first is None else utc(first.log_time_ns)
    if config is not None:
        ambient = stated_ambient(config, began)
    else:
        air, session = (reader.metadata.get(section, {}) for section in ("environment", "session"))
        moments = {
            key: datetime.fromisoformat(session[key]) for key in session.keys() & _HISTORY_KEYS.values()
        }
        ambient = _ambient({name: float(text) for name, text in air.items()}, moments, began)
    table = reader.table(ENVIRONMENT.topic)
    for name in _USUAL_AIR if len(table) else ():
        is_known = np.isfinite(table[name])
        times_ns, readings = table["time_ns"][is_known], table[name][is_known]
        if len(readings):
            ambient = replace(ambient, **{name: float(np.mean(readings))})
        if name == "temperature_c" and len(readings) >= _MIN_READINGS:
            fractions = (times_ns - times_ns[0]) / (reader.numbers.end_ns - reader.numbers.start_ns)
            if fractions[-1] >= _MIN_SPAN:
                # less the first reading, so that equal readings give a change of exactly 0
                change_k = float(np.polyfit(fractions, readings - readings[0], 1)[0])
                ambient = replace(ambient, temperature_change_k=change_k)
    return ambient


def _ambient(
    air: Mapping[str, float], moments: Mapping[str, datetime | None], began: datetime | None
) -> AmbientConditions:
    """Stated conditions, with the time from each moment of the contact's history until the run began."""
    history = {name: moments.get(key) for name, key in _HISTORY_KEYS.items()}
    since_s = {name: (began - moment).total_seconds() for name, moment in history.items() if began and moment}
    return AmbientConditions(**air, **since_s)


def ambient_warnings(ambient: AmbientConditions) -> list[str]:
    """Warnings of stated times that are impossible, and of a humidity that was hardly meant."""
    warnings = [*filter(None, [doubtful_humidity(ambient.humidity_percent)])]
    if (delay_s := ambient.dwell_s - ambient.age_s) > 0:
        warnings.append(
            f"session.surfaces_cleaned lies {delay_s:.0f} s after session.contact_made, which covers the "
            "surfaces: correct one of them"
        )
    return warnings + [
        f"session.{key} lies {-getattr(ambient, name):.0f} s after the run began: correct its date or offset"
        for name, key in _HISTORY_KEYS.items()
        if getattr(ambient, name) < 0
    ]


def expected_drag(
    ambient: AmbientConditions, pendulum: PendulumOnBall, period_s: float, config: Configuration
) -> ExpectedDrag:
    """The drag of a bar of the pendulum's size in this air; unknown conditions are those of `_USUAL_AIR`."""
    known = {name: value for name, value in ambient.known().items() if name in _USUAL_AIR}
    air = humid_air(**{**_USUAL_AIR, **known})
    stated = config.pendulum
    length, width = (None, None) if stated is None else (stated.length_m, stated.width_m)
    bar = bar_of(pendulum, period_s, length, width)
    return ExpectedDrag(
        # the air acts once on the pendulum, which all balls carry together
        drag_s=expected_drag_s(air, bar, pendulum, period_s) / balls(config),
        air_density_kg_per_m3=air.density_kg_per_m3,
        air_viscosity_pa_s=air.viscosity_pa_s,
        length_m=bar.length_m,
        width_m=bar.width_m,
        assumed=tuple(name for name in _USUAL_AIR if name not in known)
        + tuple(name for name in _BAR_SIZES if getattr(stated, name, None) is None),
    )


_U_RELATIVE, _U_RELATIVE_STATED = 0.75, 0.3
"""Relative standard uncertainty of the drag of a bar as an estimate of the pendulum's drag.

The first is a factor of two up or down. The second, where length and width are stated, is the effect of ends,
mirror and weights.
"""


class FittedDrag(NamedTuple):
    """How the fit of a run treats the drag."""

    fitted: bool = True
    """Whether a drag is fitted."""
    prior_s: Estimate | None = None
    """The prior of the fitted drag; None without one."""


FREE_DRAG = FittedDrag()


def drag_of_fit(
    config: Configuration, air: AmbientConditions, pendulum: PendulumOnBall, period_s: float
) -> tuple[FittedDrag, ExpectedDrag]:
    """The drag of the fit by the section [fit], and the drag expected of the air."""
    expected, settings = expected_drag(air, pendulum, period_s, config), config.fit
    if settings.drag == "vacuum":
        return FittedDrag(fitted=False), expected
    if settings.drag == "open":
        return FittedDrag(), expected
    if settings.drag_s is not None:
        return FittedDrag(prior_s=Estimate(settings.drag_s, settings.u_drag_s)), expected
    u_relative = _U_RELATIVE if set(_BAR_SIZES) & set(expected.assumed) else _U_RELATIVE_STATED
    return FittedDrag(prior_s=Estimate(expected.drag_s, u_relative * expected.drag_s)), expected


def evidence_of(drag: FittedDrag, harmonics: PieceHarmonics | None) -> Evidence:
    """Evidence of a run's fit: the prior of the drag, and the waveform by the harmonics if there are any."""
    return Evidence(None if harmonics is None else waveform_of(harmonics), drag.prior_s)


_DRAG_PER_K = 2.7e-3
"""Relative growth of the air's viscosity per kelvin."""
_DRIFT_NAMES = {"ageing": "friction b", "adhesion_ageing": "c", "drag_drift": "the drag"}
"""The quantity that each assumed drift changes, in words."""


def assumed_drifts(config: Configuration, air: AmbientConditions) -> dict[str, InputQuantity]:
    """Priors of the relative changes over a run, by their names in `RigQuantities`; all have the mean 0.

    The section [fit] states the uncertainties of friction, adhesion and drag. Those of the period, and of the
    drag where none is stated, follow from the change of the temperature, measured or stated, through thermal
    expansion and the viscosity of the air.
    """
    fit, change_k = config.fit, config.fit.u_temperature_change_k
    if isfinite(air.temperature_change_k):
        change_k = abs(air.temperature_change_k)
    expansion = 0.0 if config.pendulum is None else config.pendulum.expansion_per_k
    u = {
        "ageing": fit.u_ageing,
        "adhesion_ageing": fit.u_ageing if fit.u_adhesion_ageing is None else fit.u_adhesion_ageing,
        "drag_drift": _DRAG_PER_K * change_k if fit.u_drag_drift is None else fit.u_drag_drift,
        "period_drift": expansion * change_k,
    }
    return {name: InputQuantity(0.0, u_drift) for name, u_drift in u.items()}


def drift_note(drifts: Mapping[str, Floats], u_drifts: Mapping[str, float], fit: FitResult) -> str:
    """Note on drifts that a decay alone does not reveal; empty where they move no parameter by 1 u.

    `drifts` holds the change of each contact parameter by a drift of 1, `u_drifts` their uncertainties.
    """
    notes = []
    u_fit = [fit.estimate(parameter).standard_uncertainty for parameter in fit.contact_names]
    for source, name in _DRIFT_NAMES.items():
        shifts_u = np.abs(drifts[source]) * u_drifts[source] / u_fit
        shifts = [
            f"{quantity(parameter).symbol} by {shift_u:.2g} u"
            for parameter, shift_u in zip(fit.contact_names, shifts_u.tolist(), strict=True)
            if shift_u > 1
        ]
        if shifts:
            notes.append(f"{percent(u_drifts[source])} of {name} over the run would move {', '.join(shifts)}")
    if not notes:
        return ""
    return (
        f"A single decay cannot reveal ageing of the contact, or a drag that drifts: {'; '.join(notes)} of "
        "the swings; the budget includes it (fit.u_ageing, u_adhesion_ageing, u_drag_drift). Runs from other "
        "first amplitudes, and after waiting, can reveal it."
    )


_COMPONENTS = ("first", "second", "third")
_MIN_SAMPLES = 3
"""Fewest samples of a seismometer's record."""


def recorded_seismometer(reader: RecordReader, config: Configuration) -> "SeismometerRecord | None":
    """A record's seismometer samples on the frames' clock; None without any, or where none is configured."""
    # imported here: the archive needs the ambient conditions alone, and the intake loads slowly
    from rig.intake import SeismometerRecord

    if config.seismometer.kind == "none":
        return None
    table = reader.table(SEISMOMETER.topic)
    if len(table) < _MIN_SAMPLES:
        return None
    names = config.seismometer.components
    times_ns, steps_s = sample_times(table["time_ns"], table["own_time_s"])
    is_later = np.concatenate([[True], np.diff(times_ns) > 0])
    late_samples = int(np.count_nonzero(~is_later))
    value = np.column_stack([table[name] for name in _COMPONENTS[: len(names)]])
    return SeismometerRecord(
        f"{reader.path.name}: {SEISMOMETER.topic}",
        times_ns[is_later] - times_ns[0],
        value[is_later],
        names,
        int(times_ns[0]),
        absolute=False,
        understood=(
            f"columns: {', '.join(names)}",
            *(f"{CLOCK_SET} by {step:+.4g} s; times before it follow those after it" for step in steps_s),
            *([f"left out: {late_samples} samples not later than the previous one"] if late_samples else []),
        ),
    )
