"""The demonstration and the paper's pairs fitted in vacuum by name, about the air, and with an open drag.

Run as ``python -m tests.benchmarks.bench_vacuum [--quick] [--seeds N] [CASE...]`` from the repository. The
rigs are those of `configs`, once with no drag and once with that of the air; their paths are the simulated
rig's, at the camera's rate, with the noise of a tracked spot. They go through detector, second measurement
and fit as a session's do, and share no formula with them.

`shift` is the fit's distance from the one in vacuum by name, and `pull` that from the truth, both in the
fit's own standard uncertainties: in vacuum both are about 1, and a fit that leaves the drag open is only less
certain. The paper's glass pair is the demonstration's contact.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import noisy, true_path, true_turning_points
from processing.angle import ARCSEC_RAD
from processing.deflections import DeflectionUnit, slow_deflections
from processing.errors import RigError
from processing.fit import FitMethod, FitResult
from processing.surroundings import Surroundings
from processing.swing import swings_of_blocks, turning_points
from rig.analysis import settled_swings
from rig.analysis.contact_laws import fit_decay
from rig.analysis.fitted_drag import evidence_of, known_drag
from rig.instrument import complete, pendulum_on_ball
from rig.settings import Configuration, load_configuration
from tests.benchmarks.cases import chosen, run_told
from tests.benchmarks.coverage import rms

CONFIGS = Path(__file__).parents[2] / "configs"
NAMES = ("b", "p", "c", "n", "period0_s", "gamma_pa")
NOISE_ARCSEC = 0.0027
DRAGS = ("vacuum", "air", "open")
AIR_S = 1.7e-3


class Case(NamedTuple):
    """A configuration, and the drag of the air in which its rig stands."""

    config: str
    drag_s: float

    @property
    def name(self) -> str:
        return f"{self.config}, " + (f"air of {1e3 * self.drag_s:g} ms" if self.drag_s else "vacuum")


CASES = tuple(Case(name, drag_s) for drag_s in (0.0, AIR_S) for name in ("demo", "silicon", "steel"))


def fits_of(case: Case, seed: int) -> tuple[dict[str, FitResult], SimulationSettings]:
    """The reported fit of one run by each treatment of the drag, and the simulated rig."""
    config = complete(load_configuration(CONFIGS / f"{case.config}.toml"))
    rig = config.simulation
    contact = rig.contact.model_copy(update={"drag_s": case.drag_s})
    rig = rig.model_copy(update={"contact": contact, "seed": rig.seed + seed})
    end_s = float(true_turning_points(rig, config.session.final_amplitude_arcsec, run=seed).time_s[-1])
    path = true_path(rig, end_s + 0.6 * contact.period0_s, run=seed)
    noise_rad = NOISE_ARCSEC * ARCSEC_RAD
    seen = noisy(path, noise_rad, noise_rad, seed)
    samples = slow_deflections(seen.times_ns, seen.y_rad, np.full(len(seen.times_ns), noise_rad))
    swings = swings_of_blocks([samples])
    return {name: _fit(swings, samples, config, name) for name in DRAGS}, rig


def _fit(swings: Any, samples: Any, config: Configuration, drag: str) -> FitResult:
    """The exact fit of a session whose configuration says so of the drag."""
    config = config.model_copy(update={"fit": config.fit.model_copy(update={"drag": drag})})
    pendulum = pendulum_on_ball(config)
    assert pendulum is not None
    treated = known_drag(config, Surroundings(), pendulum, config.simulation.contact.period0_s)[0]
    settled = settled_swings(swings, [samples], DeflectionUnit.RAD, pendulum, config.fit, drag=treated)
    decay = fit_decay(
        turning_points(settled.swings),
        pendulum,
        config.fit,
        settled.exact,
        drag=treated.fitted,
        evidence=evidence_of(treated, settled.harmonics),
    )
    if not decay.fits:
        raise RigError(decay.problem)
    return decay.fits[FitMethod.EXACT]


def measure(case: Case, seeds: int) -> dict[str, Any]:
    """Each parameter by each treatment: mean value, u, pulls and shifts of all seeds."""
    runs, truth = [], {}
    for seed in range(seeds):
        fits, rig = fits_of(case, seed)
        truth = {name: float(getattr(rig.contact, name)) for name in NAMES}
        runs.append(fits)
    out: dict[str, Any] = {"case": case.name, "seeds": seeds, "truth": truth}
    named = [[tuple(fits["vacuum"].estimate(name)) for name in NAMES] for fits in runs]
    for drag in DRAGS:
        found = np.array([[tuple(fits[drag].estimate(name)) for name in NAMES] for fits in runs])
        values, u = found[..., 0], found[..., 1]
        pulls = (values - list(truth.values())) / u
        shifts = (values - np.array(named)[..., 0]) / u
        out[drag] = {
            "value": dict(zip(NAMES, values.mean(axis=0).tolist(), strict=True)),
            "u": dict(zip(NAMES, np.median(u, axis=0).tolist(), strict=True)),
            "rms_pull": dict(zip(NAMES, rms(pulls).tolist(), strict=True)),
            "rms_shift": dict(zip(NAMES, rms(shifts).tolist(), strict=True)),
            "largest_shift": dict(zip(NAMES, np.abs(shifts).max(axis=0).tolist(), strict=True)),
        }
        if drag != "vacuum":
            drags = np.array([tuple(fits[drag].estimate("drag_s")) for fits in runs])
            out[drag]["drag_s"] = [float(drags[:, 0].mean()), float(np.median(drags[:, 1]))]
    return out


def _shown(found: dict[str, Any]) -> None:
    print(f"{found['case']}, {found['seeds']} seeds")
    print(f"  {'':9} {'truth':>12}" + "".join(f"  {drag:^44}" for drag in DRAGS))
    print(f"  {'':9} {'':12}" + 3 * f"  {'mean':>12} {'u':>9} {'rms pull':>9} {'shift':>7}    ")
    for name, true in found["truth"].items():
        print(
            f"  {name:9} {true:12.6g}"
            + "".join(
                f"  {of['value'][name]:12.6g} {of['u'][name]:9.2g} {of['rms_pull'][name]:9.2f} "
                f"{of['rms_shift'][name]:7.2f}    "
                for of in (found[drag] for drag in DRAGS)
            )
        )
    print(
        "  drag, ms: "
        + ", ".join(
            f"{drag} {1e3 * found[drag]['drag_s'][0]:.4f} +- {1e3 * found[drag]['drag_s'][1]:.4f}"
            for drag in DRAGS[1:]
        ),
        flush=True,
    )


def run(quick: bool = False, seeds: int = 12, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    result: dict[str, Any] = {"cases": []}
    for case in chosen(CASES, only, lambda case: case.name):
        found = measure(case, 1 if quick else seeds)
        result["cases"].append(found)
        _shown(found)
    return result


if __name__ == "__main__":
    run_told(__doc__, run, 12)
