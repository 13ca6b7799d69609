"""Coverage of calibrated quantities on random simulated rigs, and of measurements made with them.

Run as ``python -m tests.benchmarks calibration [--quick]``. Ladders of tilts are such as something may have
bent; the measurements have lever, axes and clock from simulated calibration records alone.
"""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.benchmarks.cases import run_of
from tests.benchmarks.coverage import Case, measure, of_pulls
from tests.calibration.ladders import LADDERS, pull
from tests.calibration.simulated_rig import deviations
from tests.rig.analysis.spinning import Held
from tests.rig.prepare import calibrated_measurement

FRAME_RATES_HZ = (25.0, 60.0)


def of_ladder(name: str, seed: int) -> dict[str, Held]:
    return of_pulls({"scale at zero": pull(name, seed)[0]})


def of_measurement(rate_hz: float, seed: int) -> dict[str, Held]:
    with TemporaryDirectory() as folder:
        found = calibrated_measurement.measure(seed, Path(folder) / "calibrated", rate_hz=rate_hz)
    return of_pulls({name: (value - truth) / u for name, (value, u, truth) in found.items()})


def cases() -> list[Case]:
    return [
        Case("quantities", lambda seed: of_pulls(deviations(seed))),
        *(Case(f"ladder: {name}", partial(of_ladder, name)) for name in LADDERS),
        *(Case(f"measured: {rate:g} frames/s", partial(of_measurement, rate)) for rate in FRAME_RATES_HZ),
    ]


run = run_of(measure, cases, seeds=200, quick_seeds=4, apart=0)
