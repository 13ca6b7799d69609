"""Values that the analysis and a record take from a configuration, for comparison."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.camera import CameraInfo, Frame
from processing.ambient import AmbientConditions
from processing.balance import Balance, balance_checks
from processing.deflections import DeflectionUnit
from processing.instruments import DEGREE_RAD, SharedError
from processing.spot import Spot
from processing.swing import HalfCycle
from rig.analysis import clock_rate_of, drag_of_fit
from rig.analysis.ambient import assumed_drifts
from rig.analysis.contact_verdicts import rig_quantities
from rig.analysis.other_instruments import reduce_run
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.series import AnalysedRun, instrument_series
from rig.analysis.turning_plane import FollowedPlane
from rig.instrument import (
    mass_centre_height,
    nominal_effects,
    optics_of,
    pendulum_on_ball,
    session_metadata,
)
from rig.measure.preflight import frame_checks
from rig.settings import Configuration, InstrumentSettings

RAD = DeflectionUnit.RAD
_SHAPE = (640, 160)
_FRAME = Frame(np.zeros(_SHAPE, np.uint8), 0, 0, 0)
_INFO = CameraInfo("", "", "", "", 160, 640, 255, True)


def metadata(config: Configuration) -> Any:
    """Texts that are kept with a record."""
    return session_metadata(config, _INFO, _FRAME)


def optical_path(config: Configuration) -> Any:
    """The tracker's noise model, deflections of some spots, the clock's rate."""
    optics = optics_of(config, 255.0)
    spots = [Spot(x, y, 0.01, 0.02, *[1.0] * 6, 0) for x, y in ((80.0, 320.0), (90.0, 20.0), (3.0, 600.0))]
    deflected = optics.deflector(_SHAPE)(np.zeros(3, np.int64), spots)
    return repr(optics.sensor), repr(deflected), clock_rate_of(config)


def shutter(config: Configuration) -> Any:
    """Times of some spots, and what preflight says of a camera that rolls."""
    verdict = frame_checks.shutter("rolling", config.shutter, config.axes)
    return optical_path(config), verdict.measured


def apparatus(config: Configuration) -> Any:
    """The pendulum, every input of the uncertainty budget, the air's drag, drifts."""
    pendulum = pendulum_on_ball(config)
    assert pendulum is not None
    drag = drag_of_fit(config, AmbientConditions(), pendulum, 4.0)
    drifts = assumed_drifts(config, AmbientConditions())
    return repr((pendulum, rig_quantities(config), drag, drifts))


def stated_contact(config: Configuration) -> Any:
    """The same for a stated contact radius."""
    assert config.pendulum is not None
    pendulum = config.pendulum.model_copy(update={"contact_radius_m": 1e-4})
    return apparatus(config.model_copy(update={"pendulum": pendulum}))


def calibrated(config: Configuration) -> Any:
    """Both."""
    return optical_path(config), apparatus(config)


def balance(config: Configuration) -> Any:
    """Limits, height of the mass centre, and what a turn of each weight should do."""
    small: dict[str, Any] = dict.fromkeys(Balance.__dataclass_fields__, 1e-4)
    small |= {"time_ns": 0, "unit": DeflectionUnit.RAD, "period_s": 4.1, "amplitude": 5e-4}
    seen = Balance(**small)
    effects = {
        name: None if e is None else [v.tolist() for v in e] for name, e in nominal_effects(config).items()
    }
    return repr((balance_checks(seen, (1.0, 0.0), config.balance), mass_centre_height(config, seen), effects))


def instrument(config: Configuration) -> Any:
    """Results of two runs that decay unequally, as several kinds of pendulum report them."""
    stated: InstrumentSettings = config.instrument
    air, error = AmbientConditions(temperature_c=22.0, humidity_percent=48.0), SharedError("arm", scale=1e-3)
    found: list[Any] = [stated.kind, repr(stated.description().kind)]
    for kind in ("koenig", "herbert", "tomlinson"):
        for references in (stated.reference_runs, ()):
            settings = stated.model_copy(update={"kind": kind, "reference_runs": references})
            runs = [
                reduce_run(settings, FollowedPlane(_decay(b), PassingDeflections([], RAD)), air, [error])
                for b in (0.03, 0.05)
            ]
            found.append([(run.values, [tuple(row) for row in run.rows]) for run in runs])
            reduced = [AnalysedRun(path=Path(), record="", reduction=run) for run in runs]
            found.append(repr(instrument_series(reduced)))
    return repr(found)


def _decay(friction: float) -> list[HalfCycle]:
    half_s, amplitudes = 0.7, 7.0 * DEGREE_RAD * np.exp(-friction * np.arange(40))
    return [
        HalfCycle(
            k,
            round(k * half_s * 1e9),
            1e-5,
            float(a),
            1e-6,
            half_s if k else math.nan,
            1e-5,
            0.0,
            (-1) ** k,
            0,
        )
        for k, a in enumerate(amplitudes)
    ]
