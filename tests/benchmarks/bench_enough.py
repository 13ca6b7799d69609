"""Runs that end by `session.stop_when` still cover, and a plan says what runs scatter.

Run as ``python -m tests.benchmarks.bench_enough [--quick] [--seeds N] [PART...]`` from the repository; its
parts are stopping, plans, frames and share, which takes five minutes by the clock.
The half-cycles come from the tests' own integration of a driven pendulum, and from the simulated rig in the
basement world; neither shares a formula with the fit.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from acquisition.simulation.disturbances import FrameNoise, Pointing
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.contact import ContactParameters
from processing.contact.laws import PAPER
from processing.deflections import DeflectionUnit, slow_deflections
from processing.errors import RigError
from processing.fit import FitResult, fit_exact
from processing.swing import TurningPoints, swings_of_blocks, turning_points
from rig.analysis import settled_swings
from rig.instrument import complete
from rig.measure.end_of_run import EndLimits, EndOfRun
from rig.plan import expected_of, plan_expected
from rig.posterior import FIRST_HALF_CYCLES
from rig.posterior.posterior import following
from rig.settings import load_configuration
from rig.settings.stop_conditions import stop_conditions
from tests.processing.fit.decays import ARCSEC, paper_pair, with_noise
from tests.processing.fit.driven import driven_decay
from tests.rig.command_line import CONFIGS


class Stopping(NamedTuple):
    """A pair, its ground (rad/s^2/sqrt(Hz)), when its runs end, and from which half-cycle on it is looked at.

    Earlier looks are far from the end.
    """

    flat: str
    q: float
    when: tuple[str, ...]
    first: int


STOPPING = (
    Stopping("glass_k8", 1.5e-8, ("u(c)/c < 0.10", "u(b)/b < 0.02"), 290),
    Stopping("silicon", 1.5e-8, ("u(b)/b < 0.05",), 290),
    Stopping("steel", 1.5e-8, ("u(c)/c < 0.15", "u(gamma)/gamma < 0.03"), 500),
)
NOISE_ARCSEC = 0.005
LAST_ARCSEC = 8.0
BASEMENT = {"model": "peterson", "between_noise_models": 0.5, "mass_centre_height_m": 2e-4}
PLANNED = {"glass": "glass.toml", "silicon": "silicon.toml", "steel": "steel.toml"}


def stopped(points: TurningPoints, case: Stopping) -> FitResult | None:
    """The fit at which a run ends by its conditions, looked at as often as a session does."""
    end = EndOfRun(EndLimits(0.0, 1e9, stop_conditions(case.when, drag=False)))
    pendulum = paper_pair(case.flat)[1]
    count, near = FIRST_HALF_CYCLES, None
    while count <= len(points):
        if count >= case.first:
            near = fit_exact(points.first(count), pendulum, averaged=False, near=near)
            if end.reason([], 0.0, near.estimates()):
                return near
        count = following(count)
    return None


def stopping(case: Stopping, seeds: int) -> dict[str, Any]:
    """Shares of runs whose one-u intervals hold the truth, and where they ended."""
    parameters, pendulum = paper_pair(case.flat)
    inside, ends, errors, runs = [], [], [], []
    unended = failed = 0
    for seed in range(seeds):
        points = driven_decay(parameters, pendulum, q=case.q, noise_arcsec=NOISE_ARCSEC, seed=9000 + seed)
        try:
            fit = stopped(points, case)
        except RigError:
            failed += 1
            continue
        if fit is None:
            unended += 1
            continue
        ends.append(fit.half_cycles)
        runs.append(points)
        inside.append(holds(fit, parameters))
        errors.append([pull(fit, name, getattr(parameters, name)) for name in PAPER.names()])
    length = int(np.median(ends))
    fixed = [fit_exact(points.first(length), paper_pair(case.flat)[1], averaged=False) for points in runs]
    return {
        "pair": case.flat,
        "when": list(case.when),
        "seeds": seeds,
        "failed": failed,
        "reached_the_last_amplitude": unended,
        "half_cycles": np.percentile(ends, [5, 50, 95]).tolist(),
        "one_u": by_name(np.mean(inside, axis=0)),
        "one_u_at_a_fixed_length": by_name(np.mean([holds(fit, parameters) for fit in fixed], axis=0)),
        "mean_error_over_u": by_name(np.mean(errors, axis=0)),
    }


def holds(fit: FitResult, parameters: ContactParameters) -> list[bool]:
    """Whether the interval of one u holds the truth, by parameter."""
    found = []
    for name in PAPER.names():
        low, high = fit.interval(name, 0.6827)
        found.append(low <= getattr(parameters, name) <= high)
    return found


def pull(fit: FitResult, name: str, true: float) -> float:
    value, u = fit.estimate(name)
    return (value - true) / u


def plans(pair: str, runs: int) -> dict[str, Any]:
    """Scatter of runs of a pair in the basement world over what `rig plan` says of its configuration.

    The scatter of N runs is known to 1/sqrt(2 N).
    """
    wanted = [f"simulation.ground.{key}={value}" for key, value in BASEMENT.items()]
    config = complete(load_configuration(CONFIGS / PLANNED[pair], wanted))
    expected = expected_of(config)
    instants = replace(expected.conditions, averaged=False)
    (planned,) = plan_expected(expected._replace(conditions=instants), [124.0], [LAST_ARCSEC]).runs
    noise_arcsec = instants.u_amplitude_rad / ARCSEC
    values, stated, drives = [], [], []
    for seed in range(runs):
        ground = config.simulation.ground.model_copy(update={"seed": 300 + seed})
        truth = config.simulation.model_copy(update={"ground": ground})
        time_s, angle_rad = true_turning_points(truth, LAST_ARCSEC, run=seed)
        rng = np.random.default_rng([seed, 79])
        points = with_noise(time_s, np.abs(angle_rad), truth.contact.period0_s, noise_arcsec, rng)
        fit = fit_exact(points, expected.pendulum, averaged=False)
        values.append([fit.estimate(name).value for name in PAPER.names()])
        stated.append([fit.estimate(name).standard_uncertainty for name in PAPER.names()])
        drives.append(fit.ground.density_rad_per_s2_rthz.value if fit.ground is not None else np.nan)
    u = np.array([planned.u[name] for name in PAPER.names()])
    drive = expected.conditions.ground_rad_per_s2_rthz
    return {
        "pair": pair,
        "runs": runs,
        "scatter_over_planned": by_name(np.std(values, axis=0, ddof=1) / u),
        "stated_over_planned": by_name(np.median(stated, axis=0) / u),
        "drive_over_model": np.percentile(np.array(drives) / drive, [16, 50, 84]).tolist(),
    }


def frames(runs: int, *wanted: str) -> dict[str, Any]:
    """The same of configs/basement.toml as it stands, from the beam's way on the sensor, frame by frame."""
    config = complete(load_configuration(CONFIGS / "basement.toml", wanted))
    expected = expected_of(config)
    assert config.lever is not None
    (planned,) = plan_expected(expected, [124.0], [config.session.final_amplitude_arcsec]).runs
    truth, rate_hz = config.simulation, config.simulation.clock.frame_rate_hz
    # the turning points' own noise is that of frames and air; here of frames alone
    still = load_configuration(
        CONFIGS / "basement.toml",
        ["simulation.disturbances.air_arcsec=0", "simulation.disturbances.pointing_walk_px_per_sqrt_s=0"],
    )
    frame_rad = expected_of(complete(still)).conditions.u_amplitude_rad * np.sqrt(
        rate_hz * truth.contact.period0_s / 4
    )
    rad_per_px = config.lever.pixel_pitch_m / (2 * config.lever.arm_m)
    values, stated, drives = [], [], []
    for seed in range(runs):
        ground = truth.ground.model_copy(update={"seed": 300 + seed})
        settings = truth.model_copy(update={"ground": ground, "seed": 50 + seed})
        end_s = float(true_turning_points(settings, config.session.final_amplitude_arcsec).time_s[-1])
        path = true_path(settings, end_s)
        pointing = Pointing(settings, FrameNoise(settings.seed, 0), 0, 1 / rate_hz)
        seen = path.y_rad + rad_per_px * pointing.offset_px(0, len(path.y_rad))[:, 1]
        seen += frame_rad * np.random.default_rng([seed, 80]).standard_normal(len(seen))
        blocks = [slow_deflections(path.times_ns, seen, frame_rad)]
        settled = settled_swings(
            swings_of_blocks(blocks), blocks, DeflectionUnit.RAD, expected.pendulum, config.fit
        )
        fit = settled.exact or fit_exact(turning_points(settled.swings), expected.pendulum)
        values.append([fit.estimate(name).value for name in PAPER.names()])
        stated.append([fit.estimate(name).standard_uncertainty for name in PAPER.names()])
        drives.append(fit.ground.density_rad_per_s2_rthz.value if fit.ground is not None else np.nan)
    u = np.array([planned.u[name] for name in PAPER.names()])
    drive = expected.conditions.ground_rad_per_s2_rthz
    return {
        "changes": list(wanted),
        "runs": runs,
        "scatter_over_planned": by_name(np.std(values, axis=0, ddof=1) / u),
        "stated_over_planned": by_name(np.median(stated, axis=0) / u),
        "stated_b_percent": (100 * np.array(stated)[:, 0] / np.array(values)[:, 0]).round(2).tolist(),
        "drive_over_model": np.percentile(np.array(drives) / drive, [16, 50, 84]).tolist(),
    }


def share(seconds: float) -> dict[str, float]:
    """Processor time of the process that fits beside a run in real time, over the time since it began.

    It begins after 40 half-cycles; what it takes until its first fit stands apart.
    """
    with tempfile.TemporaryDirectory() as folder:
        wanted = [f"session.max_duration_s={seconds}", "simulation.real_time=true", "view.file=false"]
        words = [word for one in wanted for word in ("--set", one)]
        command = [
            sys.executable,
            "-m",
            "rig",
            "run",
            str(CONFIGS / "demo.toml"),
            "-o",
            f"{folder}/run",
            *words,
        ]
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        seen: list[tuple[float, float]] = []
        while run.poll() is None:
            child = [pid for pid in children(run.pid) if "rig.posterior" in command_of(pid)]
            with suppress(OSError):
                if child:
                    seen.append((time.monotonic(), cpu_s(child[0])))
            time.sleep(1.0)
    time_s, used_s = np.array(seen).T
    # what loads libraries and kernels is over when the process first waits
    begun = int(np.argmax(np.diff(used_s) < 0.05)) + 1
    return {
        "seconds": float(time_s[-1] - time_s[begun]),
        "start_cpu_s": float(used_s[begun]),
        "share": float((used_s[-1] - used_s[begun]) / (time_s[-1] - time_s[begun])),
        "share_with_start": float(used_s[-1] / (time_s[-1] - time_s[0])),
    }


def children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()] + [
        int(word)
        for task in Path(f"/proc/{pid}/task").iterdir()
        if task.name != str(pid)
        for word in (task / "children").read_text().split()
    ]


def command_of(pid: int) -> str:
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    return ""


def cpu_s(pid: int) -> float:
    """User and system time of a process so far."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def by_name(values: Any) -> dict[str, float]:
    return dict(zip(PAPER.names(), np.asarray(values, dtype=np.float64).tolist(), strict=True))


def words(values: Mapping[str, float]) -> str:
    return "  ".join(f"{name} {value:.2f}" for name, value in values.items())


def stoppings(seeds: int) -> list[dict[str, Any]]:
    """Runs that end by their conditions."""
    out = []
    for case in STOPPING:
        found = stopping(case, seeds)
        out.append(found)
        print(
            f"{case.flat}, {', '.join(case.when)}: {found['seeds']} runs ended after "
            f"{found['half_cycles']} half-cycles (5, 50, 95 %)"
        )
        print("  within 1 u   ", words(found["one_u"]))
        print("  fixed length ", words(found["one_u_at_a_fixed_length"]))
        print("  mean error/u ", words(found["mean_error_over_u"]), flush=True)
    return out


def run(quick: bool = False, seeds: int = 200, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    out: dict[str, Any] = {"stopping": [], "plans": [], "frames": []}
    if not only or "stopping" in only:
        out["stopping"] = stoppings(4 if quick else seeds)
    if not only or "plans" in only:
        for pair in PLANNED:
            found = plans(pair, 4 if quick else max(seeds // 2, 4))
            out["plans"].append(found)
            print(f"{pair} in the basement, {found['runs']} runs to {LAST_ARCSEC:g} arcsec")
            print("  scatter/planned", words(found["scatter_over_planned"]))
            print("  stated/planned ", words(found["stated_over_planned"]))
            print("  drive/model, 16, 50, 84 %", found["drive_over_model"], flush=True)
    if not only or "frames" in only:
        quiet = (
            "simulation.disturbances.air_arcsec=0",
            "simulation.disturbances.pointing_walk_px_per_sqrt_s=0",
        )
        for wanted in ((), quiet):
            found = frames(2 if quick else max(seeds // 10, 4), *wanted)
            out["frames"].append(found)
            print("configs/basement.toml, frame by frame", *wanted)
            print("  scatter/planned", words(found["scatter_over_planned"]))
            print("  stated/planned ", words(found["stated_over_planned"]))
            print("  drive/model, 16, 50, 84 %", found["drive_over_model"], flush=True)
    if "share" in only:
        out["share"] = share(30.0 if quick else 300.0)
        print("process that fits beside a run in real time:", out["share"], flush=True)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help="stopping or plans; both without")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=200)
    given = parser.parse_args()
    json.dump(run(given.quick, given.seeds, tuple(given.parts)), sys.stderr, indent=1)


if __name__ == "__main__":
    main()
