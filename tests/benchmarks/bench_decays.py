"""The exact fit, ground at rest and moving, with drag, knocks, ends of its own: coverage of its intervals.

Run as ``python -m tests.benchmarks decays [--quick]``. White drives come from the tests' own integration,
the basement and the recorded ground from the simulated rig; neither shares a formula with the fit. A case
named "frames", and all with drag that is not known beforehand, go through the swing detector, from 25 tilts a
second with the noise of a tracked spot; the others give the fit true turning points with noise.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.fit import fit_exact, fit_with_knocks
from processing.swing import TurningPoints, turning_points
from rig.analysis import evidence_of
from rig.analysis.ambient import FittedDrag
from rig.measure import FIRST_HALF_CYCLES
from rig.measure.end_of_run import EndOfRun
from rig.measure.posterior_worker import next_fit_half_cycles
from rig.settings.number_input import stop_conditions
from tests.benchmarks.cases import SEEDS_APART, run_of
from tests.benchmarks.coverage import (
    FRAMES_PER_S,
    NOISE_ARCSEC,
    Case,
    Floats,
    in_frames,
    measure,
    of_fit,
    truth_of,
)
from tests.processing.fit.decays import ARCSEC, PAIRS, decay, paper_pair, with_noise
from tests.processing.fit.driven import World, driven_decay, driven_path
from tests.rig.analysis.spinning import Held
from tests.shared_data import SHARED_DATA

GLASS = "glass_k8"
GROUND_FILE = SHARED_DATA / "ground" / "ulaanbaatar-lh1.csv"
SEEN_SHARE = 0.15
"""Of the seeds, for decays from frames, which take long."""

Ground = Callable[[int], dict[str, Any]]
Points = Callable[[int], TurningPoints]


def rest() -> list[Case]:
    """At rest, with and without drag, at two noises; all cases share their noise."""

    def case(flat: str, drag_s: float, noise_arcsec: float) -> Case:
        parameters, pendulum = paper_pair(flat, drag_s)

        def found(seed: int) -> Mapping[str, Held]:
            noise_seed = SEEDS_APART + seed % SEEDS_APART
            points = decay(parameters, pendulum, noise_arcsec=noise_arcsec, seed=noise_seed)
            return of_fit(fit_exact(points, pendulum, drag=drag_s > 0), truth_of(parameters, drag_s > 0))

        return Case(f"rest: {flat}, drag {drag_s:g} s, {noise_arcsec:g} arcsec", found)

    return [
        case(flat, drag_s, noise) for flat in PAIRS for drag_s in (0.0, 1e-3) for noise in (0.0005, 0.005)
    ]


def at_turns(flat: str, time_s: Floats, angle_rad: Floats, seed: int) -> TurningPoints:
    rng = np.random.default_rng([seed, 77])
    return with_noise(time_s, np.abs(angle_rad), paper_pair(flat)[0].period0_s, NOISE_ARCSEC, rng)


def seen(flat: str, path_rad: Floats, seed: int) -> TurningPoints:
    return turning_points(in_frames(path_rad, [seed, 78], paper_pair(flat)[1]).half_cycles)


def white(q: float) -> Points:
    parameters, pendulum = paper_pair(GLASS)
    return lambda seed: driven_decay(parameters, pendulum, q=q, noise_arcsec=NOISE_ARCSEC, seed=5000 + seed)


def white_frames(q: float) -> Points:
    def points(seed: int) -> TurningPoints:
        path = driven_path(*paper_pair(GLASS), q=q, seed=5000 + seed, frames_per_s=FRAMES_PER_S)[2]
        return seen(GLASS, path, seed)

    return points


def knocked(knock_arcsec: float) -> Points:
    """Of a quiet ground, with one knock at a random time."""
    parameters, pendulum = paper_pair(GLASS)

    def points(seed: int) -> TurningPoints:
        rng = np.random.default_rng([seed, 77])
        rate_rad_per_s = 2 * np.pi / parameters.period0_s
        knock = knock_arcsec * ARCSEC * rate_rad_per_s * rng.choice([-1.0, 1.0])
        world = World(event_s=rng.uniform(100.0, 600.0), knock_rad_per_s=knock)
        time_s, turn, _ = driven_path(parameters, pendulum, world, q=1e-9, seed=5000 + seed)
        return with_noise(time_s, np.abs(turn), parameters.period0_s, NOISE_ARCSEC, rng)

    return points


def simulated(flat: str, ground: Mapping[str, Any], run: int, drag_s: float = 0.0) -> SimulationSettings:
    parameters, pendulum = paper_pair(flat)
    contact = {**truth_of(parameters), "drag_s": drag_s, "contact_radius_m": pendulum.contact_radius_m}
    return SimulationSettings.model_validate(
        {
            "contact": contact,
            "ground": {"mass_centre_height_m": 2e-4, **ground, "seed": run},
            "axes": {"leakage": 0.0, "rest_slow_arcsec": 0.0, "rest_drift_slow_arcsec_per_min": 0.0},
        }
    )


def simulated_turns(flat: str, ground: Ground) -> Points:
    return lambda seed: at_turns(
        flat, *true_turning_points(simulated(flat, ground(seed), seed), run=seed), seed
    )


def simulated_path(settings: SimulationSettings, run: int) -> Floats:
    """Deflections in rad at every frame."""
    end_s = float(true_turning_points(settings, run=run).time_s[-1])
    return true_path(settings, end_s, FRAMES_PER_S, run=run).y_rad


def simulated_frames(flat: str, ground: Ground) -> Points:
    return lambda seed: seen(flat, simulated_path(simulated(flat, ground(seed), seed), seed), seed)


def basement(_: int) -> dict[str, Any]:
    return {"model": "peterson", "between_noise_models": 0.5}


def recorded(seed: int) -> dict[str, Any]:
    """The recorded ground from a random second on: 90 minutes of record, and runs of at most 40."""
    offset_s = float(np.random.default_rng([seed, 5]).integers(0, 2500))
    return {"model": "file", "file": GROUND_FILE, "file_offset_s": offset_s}


def grounds() -> list[Case]:
    """On moving ground, also with knocks; the recorded one only where its record is."""

    def case(kind: str, points: Points, flat: str = GLASS, frames: bool = False) -> Case:
        parameters, pendulum = paper_pair(flat)

        def found(seed: int) -> Mapping[str, Held]:
            return of_fit(fit_with_knocks(points(seed), pendulum, averaged=frames), truth_of(parameters))

        return Case(f"{kind}{' frames' * frames}, {flat}", found, SEEN_SHARE if frames else 1.0)

    out = [case(f"ground: q={q:g}", white(q)) for q in (0.0, 1e-9, 1e-8, 1e-7)]
    out += [case("ground: basement", simulated_turns(flat, basement), flat) for flat in PAIRS]
    if GROUND_FILE.exists():
        out.append(case("ground: recorded", simulated_turns(GLASS, recorded)))
    out += [case(f"ground: q={q:g}", white_frames(q), frames=True) for q in (0.0, 1e-8, 1e-7)]
    out += [case("ground: basement", simulated_frames(flat, basement), flat, frames=True) for flat in PAIRS]
    return out + [case(f"knock: {size:g} arcsec", knocked(size)) for size in (0.03, 0.3, 3.0)]


def air() -> list[Case]:
    """Contact or air: from frames to parameters as a session does it, with nothing known of the drag."""

    def case(drag_s: float, q: float | None) -> Case:
        parameters, pendulum = paper_pair(GLASS, drag_s)

        def found(seed: int) -> Mapping[str, Held]:
            if q is None:
                path = simulated_path(simulated(GLASS, recorded(seed), seed, drag_s), seed)
            else:
                path = driven_path(parameters, pendulum, q=q, seed=seed, frames_per_s=FRAMES_PER_S)[2]
            number, noise_seed = divmod(seed, SEEDS_APART)
            settled = in_frames(path, [noise_seed, 78, number], pendulum)
            evidence = evidence_of(FittedDrag(), settled.harmonics)
            fit = fit_exact(turning_points(settled.half_cycles), pendulum, drag=True, evidence=evidence)
            return of_fit(fit, truth_of(parameters, drag=True))

        return Case(f"air: drag {1e3 * drag_s:g} ms, " + ("recorded" if q is None else f"q={q:g}"), found)

    driven: list[float | None] = [0.0, 1e-9, 8e-9, 3e-8]
    qs = [*driven, None] if GROUND_FILE.exists() else driven
    return [case(drag_s, q) for q in qs for drag_s in (0.0, 0.5e-3, 1.7e-3, 3e-3)]


def stopped() -> list[Case]:
    """Runs that end by `session.stop_when`, looked at as often as a session does, from a half-cycle on.

    Earlier looks are far from the end.
    """

    def case(flat: str, when: tuple[str, ...], first: int) -> Case:
        parameters, pendulum = paper_pair(flat)
        conditions = stop_conditions(when, drag=False)

        def found(seed: int) -> Mapping[str, Held] | None:
            noise_seed = 9000 + seed % SEEDS_APART
            points = driven_decay(parameters, pendulum, q=1.5e-8, noise_arcsec=NOISE_ARCSEC, seed=noise_seed)
            end, count, near = EndOfRun(0.0, 1e9, conditions), FIRST_HALF_CYCLES, None
            while count <= len(points):
                if count >= first:
                    near = fit_exact(points.first(count), pendulum, averaged=False, near=near)
                    if end.reason([], 0.0, near.estimates()):
                        return of_fit(near, truth_of(parameters))
                count = next_fit_half_cycles(count)
            return None

        return Case(f"stopped: {flat}, {', '.join(when)}", found)

    return [
        case(GLASS, ("u(c)/c < 0.10", "u(b)/b < 0.02"), 290),
        case("silicon", ("u(b)/b < 0.05",), 290),
        case("steel", ("u(c)/c < 0.15", "u(gamma)/gamma < 0.03"), 500),
    ]


run = run_of(measure, rest, grounds, air, stopped, seeds=100, quick_seeds=2)
