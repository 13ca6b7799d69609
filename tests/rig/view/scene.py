"""A fixed scene for the view: a minute of a decay with everything that can be shown.

The numbers are chosen to be visible (a tilted, slowly turning ellipse with some of the fast mode); no
physics is tested with them.
"""

import math
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from acquisition.record.events import Event, EventKind
from processing.units import ARCSEC_RAD
from rig.view import layout
from rig.view.analysis import AnalysisCurve, plot_fits
from rig.view.layout import Setup
from rig.view.plotting import RunPlot

PERIOD_S = 4.07
SECONDS = 60.0
RATE_HZ = 100.0


@contextmanager
def plotting_into(rrd: Path, **setup: Any) -> Iterator[RunPlot]:
    """Draw into a Rerun file; `setup` as for `Setup`."""
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=str(uuid.uuid4()))
    known = Setup("scene", **setup)
    stream.set_sinks(rr.FileSink(rrd), default_blueprint=layout.blueprint(known))
    stream.send_recording_name("scene")
    plot = RunPlot(stream, known, limit_s=1e9, limit_rows=8000)
    yield plot
    plot.send(now=True)
    stream.flush(timeout_sec=30.0)
    stream.disconnect()


def play(plot: RunPlot, *, seed: int = 1, seconds: float = SECONDS) -> None:
    """Draw the whole scene."""
    random = np.random.default_rng(seed)
    events = ((0.0, EventKind.START), (20.0, EventKind.SPOT_LOST), (24.0, EventKind.SPOT_FOUND))
    for at_s, kind in events:
        plot.event(at_s, Event(0, kind, "of the scene"))
    for time_s in blocks(seconds):
        x, y = trajectory(time_s, random)
        plot.samples(time_s, x, y, np.zeros(len(time_s), dtype=np.int64))
        if round(time_s[0] * 10) % 20 == 0:
            _half_cycle(plot, float(time_s[0]), random)
        if round(time_s[0] * 10) % 200 == 0:
            end_s, spot = float(time_s[-1]), (320.0 + 2.2 * x[-1], 160.0 - 1.2 * y[-1])
            done, jpeg = cv2.imencode(".jpg", spot_image(spot, random))
            assert done
            plot.picture(end_s, jpeg.tobytes(), (320, 640), spot)
            plot.losses(end_s, {"missing_frames": round(end_s / 10), "lost_spots": round(end_s / 20)})
            state = f"**measuring**\n\n- time {end_s:.0f} s\n- 2 frames dropped"
            plot.text(layout.STATE, end_s, state)
            plot.clock(end_s, 31.0 + 0.02 * end_s, 12.0 / (1.0 + 0.1 * end_s))
            plot.event(end_s, Event(0, EventKind.GAP, "1 frame is missing"))
        plot.send()
    report = "# steel on K8 glass\n\n| | exact | u |\n|---|---|---|\n| p | 0.50 | 0.01 |"
    plot_fits(plot.stream, curves(), report, plot.setup.unit)


def blocks(seconds: float) -> Iterator[NDArray[np.float64]]:
    """Times of the samples, a tenth of a second at once."""
    rows = round(RATE_HZ / 10)
    for first in range(0, round(seconds * RATE_HZ), rows):
        yield np.arange(first, first + rows) / RATE_HZ


def trajectory(
    time_s: NDArray[np.float64], random: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """X and Y in arcsec."""
    amplitude = 120 * np.exp(-time_s / 900)
    phase = 2 * np.pi * time_s / PERIOD_S
    fast = 2.5 * np.exp(-time_s / 200) * np.cos(5.1 * phase)
    noise = random.normal(0, 0.02, (2, len(time_s)))
    return 0.03 * amplitude * np.cos(phase + 0.4) + fast + noise[0], amplitude * np.cos(phase) + noise[1]


def spot_image(spot: tuple[float, float], random: np.random.Generator) -> NDArray[np.uint8]:
    """A camera image of 320 x 640 with a spot."""
    y, x = np.mgrid[:320, :640]
    light = 200 * np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / (2 * 12**2))
    return np.clip(light + random.normal(8, 1.5, x.shape), 0, 255).astype(np.uint8)


def curves() -> list[AnalysisCurve]:
    """One curve and more for every panel of the analysing layout."""
    random = np.random.default_rng(2)
    time_s = np.arange(0, 1180, PERIOD_S / 2)
    amplitude = 124 * np.exp(-time_s / 300)
    u = np.full(len(time_s), 0.005)
    u_period = 0.05 / amplitude
    period = PERIOD_S * (1 + 3e-5 * amplitude**0.7)
    noise = random.normal(size=(3, len(time_s)))
    return [
        AnalysisCurve("decay", "measured", time_s, amplitude + u * noise[0], u, "points"),
        AnalysisCurve("decay", "exact fit", time_s, amplitude),
        AnalysisCurve("residuals", "exact", time_s, u * noise[0], u, "points"),
        AnalysisCurve(
            "residuals", "asymptotic", time_s, u * noise[1] + 0.004 * np.sin(time_s / 200), None, "points"
        ),
        AnalysisCurve("period", "measured", amplitude, period + u_period * noise[2], u_period, "points"),
        AnalysisCurve("period", "exact fit", amplitude, period),
        AnalysisCurve(
            "period_residuals", "exact", amplitude, 1e3 * u_period * noise[2], 1e3 * u_period, "points"
        ),
    ]


def _arcsec(value: float, u: float) -> tuple[float, float]:
    return value * ARCSEC_RAD, u * ARCSEC_RAD


def _half_cycle(plot: RunPlot, time_s: float, random: np.random.Generator) -> None:
    amplitude = 120 * np.exp(-time_s / 900)
    noise = random.normal(size=8)
    period_s = PERIOD_S * (1 + 2e-5 * amplitude) + 0.03 / amplitude * noise[1]
    columns = (amplitude + 0.005 * noise[0], 0.005, period_s, 0.03 / amplitude)
    at_s, value, u, period, u_period = (np.array([one]) for one in (time_s, *columns))
    plot.half_cycles(at_s, (value, u), (period, u_period))
    numbers = {
        "transverse": _arcsec(2.5 * np.exp(-time_s / 200) + 0.02 * noise[2], 0.02),
        "transverse_ratio": (0.02 + 0.0005 * noise[3], 0.0005),
        "width_ratio": (0.011 + 0.0005 * noise[4], 0.0005),
        "line_angle_rad": (math.radians(1.6 + 0.01 * noise[5]), math.radians(0.01)),
        "rotation_rad_per_s": (math.radians(0.05 + 0.02 * noise[6]) / 60, math.radians(0.02) / 60),
        "rest_x": _arcsec(0.5 + 0.001 * time_s, 0.01),
        "rest_y": _arcsec(-1.1 + 0.002 * time_s, 0.01),
        "drift_x_per_s": _arcsec(0.06 / 60, 0.004 / 60),
        "drift_y_per_s": _arcsec(0.12 / 60, 0.005 / 60),
        "period_ratio": (5.1 + 0.001 * noise[7], 0.003),
    }
    plot.balance(time_s, numbers)
    plot.text(layout.ADVICE, time_s, "The line is tilted by **1.60°** clockwise.")
