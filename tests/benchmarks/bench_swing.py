"""Swing detector: scatter against the Cramer-Rao bound, bias, claimed uncertainty, disturbances, speed.

Run as ``python -m tests.benchmarks.bench_swing [--quick]`` from the repository.
"""

import json
import math
import sys
from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import find_peaks

from processing.balance import BalanceEstimator
from processing.deflections import Deflections, DeflectionUnit
from processing.swing import SwingDetector
from tests.processing.fit.measured_again import again_with_fit, in_rad, noisy
from tests.processing.swing.truth import Record, contact_decay, damped_sinusoid, detect, errors, rms

FRAMES_PER_S = (30.0, 60.0, 100.0, 200.0, 500.0)
BANDS_PX = ((300.0, 100.0), (100.0, 30.0), (30.0, 10.0), (10.0, 3.0))
HALF_CYCLES = 164


def undisturbed(record: Record, _: np.random.Generator) -> Record:
    return record


def drifting(record: Record, _: np.random.Generator) -> Record:
    """1 arcsec a minute, at 2 px an arcsec."""
    return record.plus(record.time_s * (2.0 / 60.0))


def missing_frames(record: Record, rng: np.random.Generator) -> Record:
    return record.keep(rng.random(len(record.times_ns)) > 0.1)


def fast_mode(record: Record, rng: np.random.Generator) -> Record:
    """A tenth of the slow amplitude at the start, with a damping of its own."""
    t = record.time_s
    return record.plus(30.0 * np.exp(-0.01 * t) * np.cos(2 * np.pi / 0.83 * t + rng.uniform(0, 6)))


DISTURBANCES: dict[str, Callable[[Record, np.random.Generator], Record]] = {
    "none": undisturbed,
    "drift 1 arcsec/min": drifting,
    "10 % of frames missing": missing_frames,
    "fast mode of a tenth": fast_mode,
}


def gathered(runs: int, make: Callable[[np.random.Generator], Record]) -> np.ndarray:
    """Columns: true amplitude, errors over u (A, t), errors over CRLB (A, t), run."""
    rows = []
    for run_number in range(runs):
        record = make(np.random.default_rng([2023, run_number]))
        e = errors(record, detect(record))
        rows.append(
            np.column_stack(
                [
                    record.turn_amplitude[e.index],
                    e.amplitude,
                    e.time,
                    e.amplitude_to_crlb,
                    e.time_to_crlb,
                    np.full(len(e), run_number),
                ]
            )
        )
    return np.concatenate(rows)


def figures(rows: np.ndarray) -> dict[str, float]:
    """The numbers of one table row; `scatter` is the statistical error of the first four."""
    return {
        "amplitude_rms_over_crlb": rms(rows[:, 3]),
        "time_rms_over_crlb": rms(rows[:, 4]),
        "amplitude_actual_over_claimed": rms(rows[:, 1]),
        "time_actual_over_claimed": rms(rows[:, 2]),
        "amplitude_bias_over_u": float(rows[:, 1].mean()),
        "time_bias_over_u": float(rows[:, 2].mean()),
        "lag1_amplitude": float((rows[1:, 1] * rows[:-1, 1]).mean() / (rows[:, 1] ** 2).mean()),
        "lag1_time": float((rows[1:, 2] * rows[:-1, 2]).mean() / (rows[:, 2] ** 2).mean()),
        "swings": len(rows),
        "scatter": 1.0 / math.sqrt(2.0 * len(rows)),
    }


def print_figures(name: str, numbers: dict[str, float]) -> None:
    print(
        f"  {name:42s} RMS/CRLB A {numbers['amplitude_rms_over_crlb']:.3f}"
        f" t {numbers['time_rms_over_crlb']:.3f}"
        f"  actual/claimed A {numbers['amplitude_actual_over_claimed']:.3f}"
        f" t {numbers['time_actual_over_claimed']:.3f}"
        f"  bias/u A {numbers['amplitude_bias_over_u']:+.3f} t {numbers['time_bias_over_u']:+.3f}"
        f"  n {numbers['swings']:.0f} (+-{numbers['scatter']:.3f})"
    )


def accuracy(runs: int) -> dict[str, Any]:
    """Damped sinusoid from 300 px to 3 px at each frame rate: whole runs and bands of amplitude."""
    found: dict[str, Any] = {}
    for frames_per_s in FRAMES_PER_S:
        decay = partial(
            damped_sinusoid, first=300.0, last=3.0, half_cycles=HALF_CYCLES, frames_per_s=frames_per_s
        )
        rows = gathered(runs, decay)
        here: dict[str, Any] = {"whole run": figures(rows)}
        for high, low in BANDS_PX:
            band = (rows[:, 0] <= high) & (rows[:, 0] > low)
            here[f"{high:g} to {low:g} px"] = figures(rows[band])
        found[f"{frames_per_s:g} frames/s"] = here
        for name, numbers in here.items():
            print_figures(f"{frames_per_s:g} frames/s, {name}", numbers)
    return found


def _disturbed(disturb: Callable[[Record, np.random.Generator], Record], rng: np.random.Generator) -> Record:
    return disturb(damped_sinusoid(rng, 300.0, 3.0, HALF_CYCLES), rng)


def disturbances(runs: int) -> dict[str, Any]:
    found = {}
    for name, disturb in DISTURBANCES.items():
        rows = gathered(runs, partial(_disturbed, disturb))
        found[name] = figures(rows)
        print_figures(name, found[name])
    return found


def true_waveforms(runs: int, half_cycles: int) -> dict[str, Any]:
    """Integrated equation of motion with the published contacts: after 100 half-cycles, and all."""
    found = {}
    for contact in ("glass", "silicon", "steel"):
        clean = contact_decay(contact, half_cycles)
        for noise in (0.02, 0.005):

            def make(rng: np.random.Generator, clean: Record = clean, noise: float = noise) -> Record:
                n = len(clean.deflection)
                return Record(
                    clean.times_ns,
                    clean.deflection + 7.0 + noise * rng.standard_normal(n),
                    np.full(n, noise),
                    clean.turn_time_s,
                    clean.turn_amplitude,
                )

            rows = gathered(runs, make)
            settled = rows[rows[:, 0] < clean.turn_amplitude[min(100, half_cycles // 2)]]
            for name, part in (("settled", settled), ("all", rows)):
                found[f"{contact}, noise {noise:g} px, {name}"] = figures(part)
                print_figures(f"{contact}, noise {noise:g} px, {name}", figures(part))
    return found


def measured_on_fitted_motion(runs: int) -> dict[str, Any]:
    """The first 40 half-cycles and all of 400, as detected and as measured again once they were fitted.

    `common_shift` is the root mean square of the summed time errors of the first 40 over their expected
    scatter: 1 where they are independent.
    """
    found = {}
    for contact in ("glass", "silicon", "steel"):
        clean = in_rad(contact_decay(contact, 400))
        rows: dict[str, list[np.ndarray]] = {"as detected": [], "on the fitted motion": []}
        for seed in range(runs):
            record = noisy(clean, seed)
            swings = detect(record)
            for name, measured in (
                ("as detected", swings),
                ("on the fitted motion", again_with_fit(record, swings, contact)),
            ):
                e = errors(record, measured)
                columns = (e.index, e.amplitude, e.time, e.amplitude_to_crlb, e.time_to_crlb)
                rows[name].append(np.column_stack([*columns, np.full(len(e), seed)]))
        for name, parts in rows.items():
            table = np.concatenate(parts)
            early = table[(table[:, 0] > 0) & (table[:, 0] <= 40)]
            of_run = [early[early[:, 5] == seed, 2] for seed in range(runs)]
            sums = [part.sum() / math.sqrt(len(part)) for part in of_run]
            for which, part in (("first 40", early), ("all", table)):
                numbers = figures(part)
                if which == "first 40":
                    numbers["common_shift"] = rms(np.array(sums))
                found[f"{contact}, {name}, {which}"] = numbers
                print_figures(f"{contact}, {name}, {which}", numbers)
            print(f"  {'':42s} common shift of the first 40 times {rms(np.array(sums)):.2f}")
    return found


def peak_finder(record: Record) -> None:
    """scipy.signal.find_peaks on both sides."""
    find_peaks(record.deflection, distance=100)
    find_peaks(-record.deflection, distance=100)


def sinusoid_fits(record: Record, half_cycles: int) -> None:
    """scipy least squares of a damped sinusoid, frequency free, on each half-cycle."""
    for k in range(1, half_cycles):
        inside = np.abs(record.time_s - record.turn_time_s[k]) < 1.0
        t, y = record.time_s[inside] - record.turn_time_s[k], record.deflection[inside]

        def residual(p: np.ndarray, t: np.ndarray = t, y: np.ndarray = y) -> np.ndarray:
            a, turn, rate, damping, centre = p
            s = t - turn
            swing = a * np.exp(-damping * s) * (np.cos(rate * s) + damping / rate * np.sin(rate * s))
            return np.asarray(swing + centre - y)

        side = (-1.0) ** k
        least_squares(residual, [side * record.turn_amplitude[k], 0.0, 1.57, 0.01, 12.0], x_scale="jac")


def speed(rounds: int) -> dict[str, Any]:
    """Samples/s in blocks of 10,000, 100 and 1, interleaved with two peers on the same samples."""
    found: dict[str, Any] = {}
    records = {
        f"damped sinusoid, {fps:g} frames/s": damped_sinusoid(np.random.default_rng(1), 300.0, 3.0, n, fps)
        for fps, n in ((30.0, 1000), (100.0, 500), (500.0, 164))
    }
    clean = contact_decay("steel", 300)
    noise = 0.02 * np.random.default_rng(2).standard_normal(len(clean.deflection))
    records["dry friction, 100 frames/s"] = Record(
        clean.times_ns,
        clean.deflection + noise,
        np.full(len(noise), 0.02),
        clean.turn_time_s,
        clean.turn_amplitude,
    )
    for name, record in records.items():
        best = {"10000": math.inf, "100": math.inf, "1": math.inf, "find_peaks": math.inf, "fits": math.inf}
        singles = min(len(record.times_ns), 30_000)
        half_cycles = 20
        for _ in range(rounds):
            for block in (10_000, 100, 1):
                n = singles if block == 1 else len(record.times_ns)
                detector = SwingDetector()
                began = perf_counter()
                for i in range(0, n, block):
                    j = min(i + block, n)
                    detector.update(record.times_ns[i:j], record.deflection[i:j], record.u_deflection[i:j])
                best[str(block)] = min(best[str(block)], (perf_counter() - began) / n)
            began = perf_counter()
            peak_finder(record)
            best["find_peaks"] = min(best["find_peaks"], (perf_counter() - began) / len(record.times_ns))
            began = perf_counter()
            sinusoid_fits(record, half_cycles)
            seen = np.searchsorted(record.time_s, record.turn_time_s[half_cycles])
            best["fits"] = min(best["fits"], (perf_counter() - began) / seen)
        rates = {key: 1.0 / seconds for key, seconds in best.items()}
        found[name] = {
            "samples_per_s_blocks_of_10000": rates["10000"],
            "samples_per_s_blocks_of_100": rates["100"],
            "samples_per_s_blocks_of_1": rates["1"],
            "times_faster_than_least_squares_per_half_cycle": rates["10000"] / rates["fits"],
            "time_over_find_peaks": rates["find_peaks"] / rates["10000"],
        }
        print(
            f"  {name:34s} {rates['10000'] / 1e3:8.0f} k/s in blocks of 10,000,"
            f" {rates['100'] / 1e3:.0f} k/s of 100, {rates['1'] / 1e3:.0f} k/s of 1;"
            f" {rates['10000'] / rates['fits']:.0f} x scipy fits per half-cycle,"
            f" {rates['find_peaks'] / rates['10000']:.1f} x the time of find_peaks"
        )
    return found


def balance_speed(rounds: int) -> dict[str, float]:
    """Time a sample of the balance estimator, in blocks of 1 and of 1000, at 500 frames/s."""
    n = 20_000
    t = np.arange(n) * 0.002
    rng = np.random.default_rng(3)
    times_ns = np.round(t * 1e9).astype(np.int64)
    x = 3.0 * np.cos(7.5 * t) + 0.02 * rng.standard_normal(n)
    y = 200.0 * np.cos(1.55 * t) + 0.02 * rng.standard_normal(n)
    u = np.full(n, 0.02)
    deflections = Deflections(times_ns, x, y, u, u, DeflectionUnit.PX)
    best = {1: math.inf, 1000: math.inf}
    for _ in range(rounds):
        for block in best:
            estimator = BalanceEstimator()
            began = perf_counter()
            for i in range(0, n, block):
                estimator.update(deflections[i : i + block])
            best[block] = min(best[block], (perf_counter() - began) / n)
    numbers = {f"us_a_sample_blocks_of_{block}": 1e6 * seconds for block, seconds in best.items()}
    print(
        f"  balance, 500 frames/s: {best[1] * 1e6:.1f} us a sample in blocks of 1,"
        f" {best[1000] * 1e6:.1f} us in blocks of 1000"
    )
    return numbers


def run(quick: bool = False) -> dict[str, Any]:
    """Measure everything; `quick` with a tenth of the runs."""
    detect(damped_sinusoid(np.random.default_rng(0), 300.0, 100.0, 20))
    return {
        "accuracy": accuracy(4 if quick else 40),
        "disturbances": disturbances(4 if quick else 40),
        "true_waveforms": true_waveforms(2 if quick else 8, 200 if quick else 550),
        "measured_on_fitted_motion": measured_on_fitted_motion(3 if quick else 16),
        "speed": speed(2 if quick else 7),
        "balance": balance_speed(1 if quick else 3),
    }


if __name__ == "__main__":
    json.dumps(run(quick="--quick" in sys.argv))
