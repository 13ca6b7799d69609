"""Structure that is fixed on the sensor: what it costs the parameters without and with the map of its errors.

Run as ``python -m tests.benchmarks.bench_position_map [--quick] [--seeds N] [--alarms N] [CASE...]`` from the
repository. The tracker's error at every pixel is measured on frames with the structure and without noise;
swings of the tests' own integration get this error and the tracker's noise, and go through detector, second
measurement and fit as in a session: a long run, from 124 to 2 arcsec, and a short one of 33 half-cycles.
"""

import argparse
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.angle import ARCSEC_RAD
from processing.deflections import DeflectionUnit, slow_deflections
from processing.fit import FitResult, fit_exact, known_motion, measured_again
from processing.spot import SpotFlag, SpotTracker
from processing.swing import swings_of_blocks, turning_points
from rig.analysis import settled_swings
from rig.settings import FitSettings
from tests.benchmarks.bench_remeasure import swing
from tests.processing.position_map.runs import nothing, searched
from tests.processing.position_map.runs import run as short_run
from tests.processing.spot.frames import TWELVE_BIT, light

Floats = NDArray[np.float64]

PX = 0.5 * ARCSEC_RAD
NOISE_PX = 0.006
RATE = 50.0
SIGMA_PX, PEAK_DN, PEDESTAL_DN = 6.0, 2880.0, 6.0
SHAPE = (64, 600)
SHORT_S = 68.0

Structure = Callable[[Floats, Floats], Floats]
"""Light on the sensor from that without the structure and the columns of the pixels."""


def _fringes(period_px: float) -> Structure:
    return lambda clean, x: clean * (1.0 + 0.01 * np.cos(2.0 * np.pi * x / period_px + 1.0))


def _speckle(clean: Floats, x: Floats) -> Floats:
    return np.asarray(clean * (1.0 + 0.03 * np.random.default_rng(8).standard_normal(clean.shape)))


def _gradient(clean: Floats, x: Floats) -> Floats:
    """0.2 DN of 8 bits, of which the spot has 180."""
    return np.asarray(clean + 16.0 * (60.0 + 0.2 * (x - x.mean())))


def _stop(clean: Floats, x: Floats) -> Floats:
    """The edge of a stop, 2 px soft, one sigma beyond the largest deflection."""
    return clean / (1.0 + np.exp((x - 555.0) / 2.0))


CASES: dict[str, Structure] = {
    "nothing": lambda clean, x: clean,
    **{f"fringes {period:g} px": _fringes(period) for period in (12.0, 20.0, 40.0, 80.0)},
    "speckle 3 %": _speckle,
    "gradient 0.2 DN/px": _gradient,
    "stop at one end": _stop,
}


class Tracked(NamedTuple):
    """Places of the spot and errors of the tracker there, in px from the middle; flags that were raised."""

    place: Floats
    error: Floats
    flags: SpotFlag


@cache
def tracked(name: str) -> Tracked:
    tracker = SpotTracker(TWELVE_BIT)
    columns = np.broadcast_to(np.arange(float(SHAPE[1])), SHAPE)
    place = np.arange(30.0, SHAPE[1] - 30.0)
    found, flags = [], SpotFlag(0)
    # there and back: what the tracker learns of the beam, it learns from the first frames of a run
    for x in (*place[::-1], *place):
        seen = CASES[name](light(SHAPE, float(x), 31.7, SIGMA_PX, PEAK_DN), columns) + PEDESTAL_DN
        spot = tracker.track(np.clip(np.rint(seen), 0, TWELVE_BIT.full_scale_dn).astype(np.uint16))
        found.append(spot.x_px)
        flags |= SpotFlag(spot.flags)
    found = found[len(place) :]
    return Tracked(place - place.mean(), np.array(found) - place, flags)


def pulls(fit: FitResult, truth: Any) -> list[float]:
    return [
        (fit.estimate(name).value - getattr(truth, name)) / fit.estimate(name).standard_uncertainty
        for name in fit.contact_names
    ]


def measure(name: str, seeds: int, short: bool) -> dict[str, Any]:
    """Errors in stated uncertainties, and stated uncertainties of b and n, without and with the map."""
    samples, sensor = swing(RATE), tracked(name)
    count = int(SHORT_S * RATE) if short else len(samples.time_s)
    angle = samples.angle_rad[:count]
    times_ns = np.rint(samples.time_s[:count] * 1e9).astype(np.int64)
    u = np.full(count, NOISE_PX * PX)
    rows: dict[str, list[list[float]]] = {"without": [], "with": []}
    stated: dict[str, list[tuple[float, float]]] = {"without": [], "with": []}
    maps = 0
    for seed in range(seeds):
        noise = u * np.random.default_rng([seed, 41]).standard_normal(count)
        seen = angle + PX * np.interp(angle / PX, sensor.place, sensor.error) + noise
        block = slow_deflections(times_ns, seen, u)
        swings = swings_of_blocks([block])
        first = fit_exact(turning_points(swings), samples.pendulum)
        largest = float(turning_points(swings).amplitude[0])
        again = measured_again(swings, [block], known_motion(first.parameters, samples.pendulum, largest))
        settled = settled_swings(swings, [block], DeflectionUnit.RAD, samples.pendulum, FitSettings())
        maps += settled.position_map is not None
        fits = {
            "without": fit_exact(turning_points(again), samples.pendulum, near=first),
            "with": settled.exact or fit_exact(turning_points(settled.swings), samples.pendulum),
        }
        for kind, fit in fits.items():
            rows[kind].append(pulls(fit, samples.parameters))
            stated[kind].append(
                (fit.estimate("b").standard_uncertainty, fit.estimate("n").standard_uncertainty)
            )
    return {
        "case": name,
        "run": "short" if short else "long",
        "seeds": seeds,
        "maps": maps,
        "rms_error_px": float(np.std(sensor.error)),
        "flags": int(sensor.flags),
        **{
            f"{kind}_{what}": value
            for kind in rows
            for what, value in (
                ("rms", float(np.sqrt(np.mean(np.square(rows[kind]))))),
                ("largest", float(np.max(np.abs(np.mean(rows[kind], axis=0))))),
                ("u_b", float(np.median([u_b for u_b, _ in stated[kind]]))),
                ("u_n", float(np.median([u_n for _, u_n in stated[kind]]))),
            )
        },
    }


def run(
    quick: bool = False, seeds: int = 10, alarms: int = 1000, only: tuple[str, ...] = ()
) -> dict[str, Any]:
    found = []
    for name in CASES:
        if only and not any(word in name for word in only):
            continue
        for short in (False, True):
            one = measure(name, 2 if quick else seeds, short)
            found.append(one)
            print(
                f"{name:20} {one['run']:5} {one['rms_error_px']:.4f} px rms, map in {one['maps']} of "
                f"{one['seeds']}; error/u rms {one['without_rms']:.2f} -> {one['with_rms']:.2f}, largest "
                f"mean {one['without_largest']:.2f} -> {one['with_largest']:.2f}; u(b) "
                f"{one['without_u_b']:.2g} -> {one['with_u_b']:.2g}, u(n) {one['without_u_n']:.2g} "
                f"-> {one['with_u_n']:.2g}",
                flush=True,
            )
    count = 10 if quick else alarms
    false = sum(searched(short_run(nothing, seed)) is not None for seed in range(count)) if not only else 0
    print(f"false maps: {false} of {count} runs without structure" if not only else "")
    return {"cases": found, "false_maps": false, "runs_without_structure": count}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="parts of names of cases; all without")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--alarms", type=int, default=1000)
    words = parser.parse_args()
    run(words.quick, words.seeds, words.alarms, tuple(words.cases))
