"""What a run says while it is measured: errors of the live fit over its uncertainties.

Run as ``python -m tests.benchmarks.bench_live_fit [--quick] [--seeds N] [--set KEY=VALUE]...`` from the
repository. Frames of configs/basement.toml, from the beam's way on the sensor: the simulated rig integrates
the motion, and shares no formula with the fit. `LivePosterior` fits them in its process; beside it stands the
fit of the same half-cycles as they were detected.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.simulation.disturbances import FrameNoise, Pointing
from acquisition.simulation.true_path import true_path
from processing.arrays import Floats
from processing.contact.laws import PAPER
from processing.deflections import Deflections, slow_deflections
from processing.errors import RigError
from processing.estimate import Estimate
from processing.fit import Evidence, FitOfSwings, Linearised, points_in_true_time, with_misfit
from processing.periods import mean_period
from processing.swing import HarmonicsWatch, Swing, SwingDetector, SwingHarmonics
from rig.analysis import evidence_of, known_drag, stated_surroundings
from rig.instrument import complete
from rig.plan import expected_of
from rig.posterior import FittedModel, LivePosterior
from rig.settings import Configuration, load_configuration
from tests.rig.command_line import CONFIGS

LOOKS = (40, 60, 100, 150, 220, 300)
"""Half-cycles after which the run is fitted, each fit near the one before."""
SHOWN = LOOKS[1::2]
NAMES = PAPER.names(drag=True)
STILL = ("simulation.disturbances.air_arcsec=0", "simulation.disturbances.pointing_walk_px_per_sqrt_s=0")


class Basement:
    """The basement as configured, and what a frame of it tells."""

    def __init__(self, wanted: Sequence[str]) -> None:
        self.config: Configuration = complete(load_configuration(CONFIGS / "basement.toml", list(wanted)))
        still = expected_of(complete(load_configuration(CONFIGS / "basement.toml", [*wanted, *STILL])))
        self.pendulum = still.pendulum
        truth = self.config.simulation
        self.rate_hz = truth.clock.frame_rate_hz
        self.frame_rad = still.conditions.u_amplitude_rad * float(
            np.sqrt(self.rate_hz * truth.contact.period0_s / 4)
        )

    @property
    def truth(self) -> Floats:
        """Parameters in the order of `NAMES`."""
        return np.array([getattr(self.config.simulation.contact, name) for name in NAMES])

    def deflections(self, seed: int, end_s: float) -> Deflections:
        """What the sensor has seen of a run until then."""
        truth, lever = self.config.simulation, self.config.lever
        assert lever is not None
        ground = truth.ground.model_copy(update={"seed": 300 + seed})
        settings = truth.model_copy(update={"ground": ground, "seed": 50 + seed})
        path = true_path(settings, end_s)
        pointing = Pointing(settings, FrameNoise(settings.seed, 0), 0, 1 / self.rate_hz)
        rad_per_px = lever.pixel_pitch_m / (2 * lever.arm_m)
        seen = path.y_rad + rad_per_px * pointing.offset_px(0, len(path.y_rad))[:, 1]
        seen += self.frame_rad * np.random.default_rng([seed, 80]).standard_normal(len(seen))
        return slow_deflections(path.times_ns, seen, self.frame_rad)

    def evidence(self, swings: Sequence[Swing], harmonics: SwingHarmonics) -> Evidence:
        """As a session has it."""
        period_s = mean_period(points_in_true_time(swings, 1.0))
        drag, _ = known_drag(self.config, stated_surroundings(self.config), self.pendulum, period_s)
        return evidence_of(drag, harmonics)


def as_detected(basement: Basement, swings: Sequence[Swing], samples: Deflections) -> dict[str, Estimate]:
    """The fit of the half-cycles as they were found."""
    watch = HarmonicsWatch(swings)
    watch.update(samples)
    how = FitOfSwings(basement.pendulum, evidence=basement.evidence(swings, watch.found()))
    fit = with_misfit(Linearised.of(how.points(swings), basement.pendulum, how.of(swings)))
    return {name: fit.estimate(name) for name in NAMES}


def looked_at(
    basement: Basement, posterior: LivePosterior, seed: int
) -> tuple[dict[int, list[dict[str, Estimate]]], list[float]]:
    """Estimates as detected and live by number of half-cycles, and processor seconds of each fit."""
    period_s = basement.config.simulation.contact.period0_s
    samples = basement.deflections(seed, (LOOKS[-1] / 2 + 10) * 1.01 * period_s)
    good = [s for s in SwingDetector().update(samples.times_ns, samples.y, samples.u_y) if not s.flags]
    posterior.begin()
    found, cost_s, begun, since, used_s = {}, [], 0, 0, 0.0
    for count in LOOKS:
        end = int(np.searchsorted(samples.times_ns, good[count].turn_time_ns))
        posterior.take(good[since:count], samples[begun:end])
        begun, since = end, count
        assert posterior.worker_pid is not None
        if count > LOOKS[0]:
            cost_s.append(cpu_s(posterior.worker_pid) - used_s)
        used_s = cpu_s(posterior.worker_pid)
        if count in SHOWN and posterior.latest.half_cycles == count:
            found[count] = [
                as_detected(basement, good[:count], samples[:end]),
                dict(posterior.latest.estimates),
            ]
    return found, cost_s


def cpu_s(pid: int) -> float:
    """User and system time of a process so far."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def measure(seeds: int, wanted: Sequence[str]) -> dict[str, Any]:
    """Rms errors over u and shares within 1 u, as detected and live, by number of half-cycles."""
    basement = Basement(wanted)
    pulls: dict[int, list[Floats]] = {count: [] for count in SHOWN}
    u: dict[int, list[Floats]] = {count: [] for count in SHOWN}
    costs, failed = [], 0
    posterior = LivePosterior(FittedModel(basement.pendulum), basement.evidence, in_step=True)
    for seed in range(seeds):
        try:
            found, cost_s = looked_at(basement, posterior, seed)
        except RigError as error:
            failed += 1
            print(f"  seed {seed}: {error}", flush=True)
            continue
        costs.append(cost_s)
        for count, both in found.items():
            values = np.array([[[*one[name]] for name in NAMES] for one in both])
            pulls[count].append((values[:, :, 0] - basement.truth) / values[:, :, 1])
            u[count].append(values[:, :, 1])
    posterior.close()
    out: dict[str, Any] = {"changes": list(wanted), "seeds": seeds, "failed": failed, "looks": {}}
    for count in SHOWN:
        z = np.array(pulls[count])
        out["looks"][count] = {
            "runs": len(z),
            **{
                title: {
                    "rms_pull": by_name(np.sqrt(np.mean(z[:, row] ** 2, axis=0))),
                    "one_u": by_name(np.mean(np.abs(z[:, row]) < 1, axis=0)),
                    "u": by_name(np.median(np.array(u[count])[:, row], axis=0)),
                }
                for row, title in enumerate(("as_detected", "live"))
            },
        }
    out["fit_cpu_s"] = dict(zip(LOOKS[1:], np.median(costs, axis=0).tolist(), strict=True))
    return out


def by_name(values: Floats) -> dict[str, float]:
    return dict(zip(NAMES, values.tolist(), strict=True))


def run(quick: bool = False, seeds: int = 30, wanted: Sequence[str] = ()) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    began_s = time.monotonic()
    out = measure(2 if quick else seeds, wanted)
    print(f"basement {' '.join(wanted)}: {out['seeds']} runs, {out['failed']} failed")
    for count, look in out["looks"].items():
        for title in ("as_detected", "live"):
            for key in ("rms_pull", "one_u"):
                numbers = "".join(f"  {name} {value:.2f}" for name, value in look[title][key].items())
                print(f"  {count:3} half-cycles, {title:11} {key:8}{numbers}")
    print("  processor time of a fit / s:", {k: round(v, 2) for k, v in out["fit_cpu_s"].items()})
    print(f"  {time.monotonic() - began_s:.0f} s by the clock", flush=True)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="wanted")
    given = parser.parse_args()
    json.dump(run(given.quick, given.seeds, given.wanted), sys.stderr, indent=1)


if __name__ == "__main__":
    main()
