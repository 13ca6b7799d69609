"""Spot tracker against the Cramer-Rao bound, and with disturbances.

Run as ``python -m tests.benchmarks.bench_spot_accuracy [--quick]`` from the repository.
"""

import json
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from processing.spot import Spot, SpotFlag, SpotTracker
from tests.processing.spot.frames import (
    EIGHT_BIT,
    TWELVE_BIT,
    bound_px,
    errors_px,
    exposed,
    light,
    side_of,
    tilted_light,
)

Make = Callable[[float, float, np.random.Generator], NDArray[Any]]


def point(
    sigma: float, peak: float, bits: int, frames: int, prnu: float = 0.0, told: bool = False
) -> dict[str, Any]:
    """RMS over the bound, claimed over actual, mean error of one kind of frame.

    The bound is that of such frames, uneven pixels included; the one of even pixels stands beside it.
    `told`: the tracker's sensor model has the PRNU.
    """
    sensor, scale = (EIGHT_BIT, 1) if bits == 8 else (TWELVE_BIT, 16)
    rng = np.random.default_rng([int(10 * sigma), int(peak), bits, int(1000 * prnu)])
    n = side_of(sigma)
    truth = n / 2 + rng.uniform(-0.5, 0.5, (frames, 2))
    tracker = SpotTracker(replace(sensor, prnu=prnu) if told else sensor)
    spots = [
        tracker.track(exposed(light((n, n), x, y, sigma, scale * peak), rng, sensor=sensor, prnu=prnu))
        for x, y in truth
    ]
    errors = errors_px(spots, truth)
    claimed = np.array([(spot.u_x_px, spot.u_y_px) for spot in spots])
    rms = math.sqrt(np.mean(errors**2))
    bound, even_bound = (
        bound_px((n, n), n / 2, n / 2, sigma, scale * peak, sensor, share) for share in (prnu, 0.0)
    )
    return {
        "sigma_px": sigma,
        "peak_8bit_dn": peak,
        "bits": bits,
        "prnu": prnu,
        "told": told,
        "frames": frames,
        "rms_mpx": 1e3 * rms,
        "bound_mpx": 1e3 * bound,
        "rms_over_bound": rms / bound,
        "rms_over_bound_of_even_pixels": rms / even_bound,
        "claimed_over_actual": 1.0 / math.sqrt(np.mean((errors / claimed) ** 2)),
        "bias_mpx": 1e3 * float(errors.mean()),
        "u_ratio": 1.0 / math.sqrt(2.0 * errors.size),
    }


def _with_hot_pixels(x: float, y: float, rng: np.random.Generator) -> NDArray[Any]:
    frame = exposed(light((96, 96), x, y, 6, 180), rng)
    for column, row in rng.integers(33, 63, (3, 2)):
        frame[row, column] = 255
    return frame


def _peak(peak: float) -> Make:
    return lambda x, y, rng: exposed(light((96, 96), x, y, 6, peak), rng)


def _ghost(sigma: float) -> Make:
    def make(x: float, y: float, rng: np.random.Generator) -> NDArray[Any]:
        shape = (200, 200)
        return exposed(light(shape, x, y, sigma, 180) + light(shape, x + 40, y, sigma, 4.5), rng)

    return make


def _tilted(x: float, y: float, rng: np.random.Generator) -> NDArray[Any]:
    return exposed(tilted_light((96, 96), x, y, (8, 5), 0.5, 180), rng)


DISTURBED: dict[str, tuple[Make, tuple[float, float], int]] = {
    "clean": (_peak(180), (48, 48), 2000),
    "three hot pixels": (_with_hot_pixels, (48, 48), 2000),
    "clipped at 1.6x": (_peak(400), (48, 48), 2000),
    "clipped at 4x": (_peak(1000), (48, 48), 2000),
    "edge at 1.5 sigma": (_peak(180), (9, 48), 2000),
    "ghost 2.5 %, sigma 6": (_ghost(6), (90, 100), 500),
    "ghost 2.5 %, sigma 12": (_ghost(12), (90, 100), 500),
    "tilted 8 x 5": (_tilted, (48, 48), 200),
}


def disturbed(name: str, cold: bool, part: float) -> dict[str, Any]:
    """One row of the robustness table; cold: each frame searched for itself."""
    make, centre, frames = DISTURBED[name]
    rng = np.random.default_rng(17)
    truth = np.array(centre) + rng.uniform(-0.5, 0.5, (max(20, int(part * frames)), 2))
    tracker = SpotTracker(EIGHT_BIT)
    spots: list[Spot] = []
    for x, y in truth:
        if cold:
            tracker.reset()
        spots.append(tracker.track(make(x, y, rng)))
    found = np.array([not spot.flags & SpotFlag.LOST for spot in spots])
    errors = errors_px(spots, truth)[found]
    claimed = np.array([(spot.u_x_px, spot.u_y_px) for spot in spots])[found]
    return {
        "name": name,
        "cold": cold,
        "frames": len(spots),
        "lost": int((~found).sum()),
        "rms_mpx": 1e3 * math.sqrt(np.mean(errors**2)),
        "bias_x_mpx": 1e3 * float(errors[:, 0].mean()),
        "u_bias_mpx": 1e3 * float(errors[:, 0].std()) / math.sqrt(len(errors)),
        "claimed_over_actual": 1.0 / math.sqrt(np.mean((errors / claimed) ** 2)),
    }


def points_of(frames: int) -> list[dict[str, Any]]:
    """Undisturbed frames of every width, brightness and depth; and with pixels that differ, told or not."""
    return points_told(frames) + [point(6, peak, 8, frames, prnu=0.01) for peak in (20, 80, 200)]


def points_told(frames: int) -> list[dict[str, Any]]:
    """Of these the tracker's sensor model knows all; what it does not know its uncertainties cannot hold."""
    points = [
        point(sigma, peak, bits, frames) for bits in (8, 12) for sigma in (3, 6, 12) for peak in (20, 80, 200)
    ]
    return points + [point(6, peak, 8, frames, prnu=0.01, told=True) for peak in (20, 80, 200)]


def run(quick: bool = False) -> dict[str, Any]:
    """All points; numbers as plain values."""
    frames = 400 if quick else 10_000
    points = points_of(frames)
    rows = [disturbed(name, cold, 0.05 if quick else 1.0) for name in DISTURBED for cold in (False, True)]
    console = Console()
    table = Table(title=f"spot: {frames} frames a point")
    columns = ("sigma", "peak", "bits", "PRNU", "RMS mpx", "RMS/CRLB", "of even pixels")
    for column in (*columns, "claimed/actual", "bias mpx"):
        table.add_column(column, justify="right")
    for p in points:
        table.add_row(
            f"{p['sigma_px']:g}", f"{p['peak_8bit_dn']:g}", f"{p['bits']}",
            f"{p['prnu']:g}{' known' if p['told'] else ''}",
            f"{p['rms_mpx']:.2f}", f"{p['rms_over_bound']:.3f}", f"{p['rms_over_bound_of_even_pixels']:.3f}",
            f"{p['claimed_over_actual']:.3f}", f"{p['bias_mpx']:+.3f}",
        )  # fmt: skip
    console.print(table)
    table = Table(title="spot, disturbed (sigma 6, peak 180 where nothing else is said)")
    for column in ("what", "start", "frames", "lost", "RMS mpx", "bias x mpx", "claimed/actual"):
        table.add_column(column, justify="right")
    for r in rows:
        table.add_row(
            r["name"], "cold" if r["cold"] else "warm", f"{r['frames']}", f"{r['lost']}",
            f"{r['rms_mpx']:.2f}", f"{r['bias_x_mpx']:+.2f} +- {r['u_bias_mpx']:.2f}",
            f"{r['claimed_over_actual']:.3f}",
        )  # fmt: skip
    console.print(table)
    return {"points": points, "disturbed": rows}


if __name__ == "__main__":
    json.dump(run("--quick" in sys.argv), sys.stderr, indent=1)
