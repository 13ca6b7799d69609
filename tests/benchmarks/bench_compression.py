"""Films of known swings, compressed: the errors of decrement and period in their uncertainties."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from rig.analysis.table_fit import analyse_trajectory
from rig.intake import FilmAsked, film_trajectory
from tests.acquisition.cameras.made_films import NX, NY, Film, write_film

RATE_HZ, COUNT = 30, 600
H264 = [("libx264", "mp4", {"crf": crf}) for crf in ("8", "12", "18", "23", "28")]
OTHERS = [
    ("libx265", "mp4", {"crf": "28", "x265-params": "log-level=none"}),
    ("mpeg4", "avi", {"q": "5"}),
]
SWINGS = ((50.0, 1.7, 6.0), (50.0, 1.7, 20.0), (20.0, 4.0, 40.0))
"""First amplitude in px, period and time constant in s."""


def run(quick: bool = False) -> dict[str, Any]:
    """Every codec with every swing and two strengths of noise (`quick`: crf 23 alone)."""
    codecs = [H264[3]] if quick else [*H264, *OTHERS]
    shown = Table("film", "swing", "noise, DN", "error, %", "u, %", "error / u", "of period")
    pulls, of_period = [], []
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for codec, ending, options in codecs:
            for swing in SWINGS:
                for noise_dn in (1.5,) if quick else (0.5, 1.5, 4.0):
                    film = Film(codec=codec, ending=ending, pixels="yuv420p", options=options)
                    path = write_film(Path(folder) / f"{len(rows)}.{ending}", pictures(swing, noise_dn), film)
                    found = analyse_trajectory(path, film_trajectory(path, FilmAsked()), None)
                    true = swing[1] / swing[2]
                    value, u = found.longest.results.number("log_decrement")
                    pulls.append((value - true) / u)
                    period_s, u_s = found.longest.results.number("mean_period_s")
                    of_period.append((period_s - swing[1]) / u_s)
                    name = f"{codec} {options.get('crf', '')}".strip()
                    error, of_u = 100.0 * (value / true - 1.0), 100.0 * u / true
                    rows.append({"film": name, "swing": swing, "error, %": error, "u, %": of_u})
                    shown.add_row(
                        name,
                        f"{swing[0]:g} px, {swing[1]:g} s, {swing[2]:g} s",
                        f"{noise_dn:g}",
                        f"{error:+.3f}",
                        f"{of_u:.3f}",
                        f"{pulls[-1]:+.2f}",
                        f"{of_period[-1]:+.2f}",
                    )
    Console().print(shown)
    rms, largest = float(np.sqrt(np.mean(np.square(pulls)))), float(np.abs(pulls).max())
    print(f"{len(pulls)} films: rms of error / u {rms:.2f}, largest {largest:.2f}")
    rms_s, largest_s = float(np.sqrt(np.mean(np.square(of_period)))), float(np.abs(of_period).max())
    print(f"of the period: rms {rms_s:.2f}, largest {largest_s:.2f}")
    return {"films": rows, "rms of error / u": rms, "largest": largest, "rms of period": rms_s}


def pictures(swing: tuple[float, float, float], noise_dn: float) -> list[np.ndarray]:
    """A round spot that swings, with noise of every pixel."""
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:NY, :NX]
    amplitude_px, period_s, tau_s = swing
    made = []
    for k in range(COUNT):
        t = k / RATE_HZ
        at = 80.3 + amplitude_px * np.exp(-t / tau_s) * np.sin(2.0 * np.pi * t / period_s)
        light = 180.0 * np.exp(-((x - at) ** 2 + (y - 47.8) ** 2) / 50.0) + 20.0
        noisy = light + noise_dn * rng.standard_normal(light.shape)
        made.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return made
