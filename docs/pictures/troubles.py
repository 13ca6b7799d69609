"""Draws what spoils a measurement, and how it looks, from runs of the simulated rig: make drawings.

python docs/pictures/troubles.py [NAME ...]
"""

import io
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import rig
from rig.measure import record_plainly
from rig.settings import load_configuration
from rig.terminal import palette

HERE = Path(__file__).resolve().parent / "troubles"
CONFIGURATION = HERE.parents[2] / "configs" / "demo.toml"
SMALL = {
    "simulation.sensor.width_px": 160,
    "camera.frame_rate_hz": 50,
}
Record = Any


class Trouble(NamedTuple):
    """What is changed in the simulation, and what is drawn of it."""

    title: str
    seconds: int
    keys: Mapping[str, object]
    draw: Callable[[Axes, Record], None]


def trajectory(axes: Axes, record: Record) -> None:
    """The first two periods as they lie on the sensor."""
    path = record.deflections()
    first = path.times_s < 8.1
    axes.plot(path.shown_x[first], path.shown_y[first], color=palette.BLUE, lw=1)
    axes.set(xlabel="X, arcsec", ylabel="Y, arcsec", xlim=(-12, 12), ylim=(-140, 140))


def picture(axes: Axes, record: Record) -> None:
    """The spot in the first whole frame."""
    show(axes, first_frame(record))


def fringed(axes: Axes, record: Record) -> None:
    """The same through a cover glass: the simulated sensor has none, the fringes are drawn over it."""
    image = first_frame(record)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    light = (image - 6.0) * (1 + 0.15 * np.cos(2 * np.pi * (rows + 0.6 * columns) / 9.0)) + 6.0
    show(axes, light)


def first_frame(record: Record) -> np.ndarray:
    """Pixels about the spot."""
    image = next(iter(record.images())).image
    y, x = np.unravel_index(int(np.argmax(image)), image.shape)
    return np.asarray(image[max(y - 32, 0) : y + 32, max(x - 50, 0) : x + 70], dtype=float)


def show(axes: Axes, image: np.ndarray) -> None:
    """Grey values, and the row through the peak."""
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, aspect="equal")
    row = image[image.shape[0] // 2]
    axes.plot(62 - row / 255 * 24, color=palette.ORANGE, lw=1)
    axes.set(xticks=[], yticks=[], xlabel="orange: grey values of the row through the peak")


def amplitudes(axes: Axes, record: Record) -> None:
    """Amplitude of every half-cycle against time."""
    half_cycles = record.half_cycles()
    times_s = (half_cycles["turn_time_ns"] - half_cycles["turn_time_ns"][0]) * 1e-9
    axes.plot(
        times_s, np.degrees(half_cycles["amplitude_rad"]) * 3600, "o-", ms=3, lw=0.7, color=palette.BLUE
    )
    axes.set(xlabel="time, s", ylabel="amplitude, arcsec", ylim=(112, 130))


def periods(axes: Axes, record: Record) -> None:
    """Twice the half-period of every half-cycle."""
    half_cycles = record.half_cycles()
    axes.plot(
        2e3 * (half_cycles["half_period_s"] - np.nanmean(half_cycles["half_period_s"])), "o-", ms=3, lw=0.7
    )
    axes.set(xlabel="half-cycle", ylabel="period less its mean, ms", ylim=(-2.5, 2.5))


def shape(axes: Axes, record: Record) -> None:
    """What a damped sine leaves of the first two periods."""
    path = record.deflections()
    period_s = 2 * float(np.nanmedian(record.half_cycles()["half_period_s"]))
    first = path.times_s < 2 * period_s
    time_s, y = path.times_s[first], path.shown_y[first]
    phase = 2 * np.pi * time_s / period_s
    waves = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
    basis = np.concatenate([waves, waves * time_s]).T
    axes.plot(time_s, y - basis @ np.linalg.lstsq(basis, y)[0], lw=0.7, color=palette.BLUE)
    axes.set(xlabel="time, s", ylabel="Y less a damped sine, arcsec", ylim=(-1.5, 1.5))


TROUBLES = {
    "tilt": Trouble(
        "out of balance, camera turned",
        12,
        {
            "simulation.axes.leakage_quadrature": 0.04,
            "simulation.axes.slow_angle_rad": 0.03,
            "simulation.fast.amplitude_arcsec": 2.0,
        },
        trajectory,
    ),
    "ghost": Trouble("light from a second surface", 2, {"simulation.optics.ghost_relative": 0.2}, picture),
    "saturation": Trouble("too much light", 2, {"simulation.optics.peak_dn": 600}, picture),
    "fringes": Trouble("a cover glass", 2, {}, fringed),
    "knock": Trouble(
        "a knock at 12 s", 24, {"faults.draught_at_s": 12.3, "faults.draught_arcsec": 6}, amplitudes
    ),
    "ground": Trouble(
        "a noisy building",
        24,
        {
            "simulation.ground.model": '"peterson"',
            "simulation.ground.between_noise_models": 1.0,
            "simulation.ground.mass_centre_height_m": 1e-3,
        },
        periods,
    ),
    "rolling-shutter": Trouble(
        "rows exposed one after the other",
        12,
        {"simulation.sensor.row_time_s": 15e-6, "shutter.row_time_s": 0.0},
        shape,
    ),
}


@cache
def simulated(seconds: int, keys: tuple[tuple[str, object], ...]) -> Record:
    """A short record of the demonstration with some keys changed."""
    folder = Path(tempfile.mkdtemp())
    changes = [f"{key}={value}" for key, value in (SMALL | dict(keys)).items()]
    changes.append(f"session.max_duration_s={seconds}")
    record_plainly(load_configuration(CONFIGURATION, changes), CONFIGURATION, folder / "run.mcap")
    return rig.open_record(folder / "run.mcap")


def drawn(name: str) -> bytes:
    """PNG: on the left as it should be, on the right with the trouble."""
    trouble = TROUBLES[name]
    figure = Figure(figsize=(7.2, 2.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    usual = picture if trouble.draw is fringed else trouble.draw
    usual(left, simulated(trouble.seconds, ()))
    trouble.draw(right, simulated(trouble.seconds, tuple(trouble.keys.items())))
    left.set_title("as it should be", fontsize=10)
    right.set_title(trouble.title, fontsize=10)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return out.getvalue()


if __name__ == "__main__":
    HERE.mkdir(exist_ok=True)
    for name in sys.argv[1:] or TROUBLES:
        (HERE / f"{name}.png").write_bytes(drawn(name))
        print(f"{name}.png")
