"""Inputs that the budget omits: shift of the results due to an error of typical size in each."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.settings import FastModeTruth, ReleaseTruth
from acquisition.simulation.true_path import true_path
from calibration.axes import Axes, deflections
from calibration.light_lever import Lever
from processing.angle import ARCSEC_RAD
from processing.contact.hertz import MATERIALS, pendulum_on_ball
from processing.contact.laws import PAPER
from processing.deflections import slow_deflections
from processing.fit.exact import fit_exact
from processing.swing import swings_of, turning_points
from rig.analysis import settled_swings
from rig.settings import FitSettings
from tests.calibration.simulated_rig import climb_tilts, draw_rig, spots_of, swing_for_axes

FINAL_ARCSEC = 4.0
JITTER_S = 15e-6


@dataclass(frozen=True)
class Spots:
    """Spots of one measurement with true lever and axes, and what their makers knew of them."""

    times_s: NDArray[np.float64]
    x_px: NDArray[np.float64]
    y_px: NDArray[np.float64]
    u_px: float
    lever: Lever
    axes: Axes


def _found(spots: Spots) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The six parameters and their standard uncertainties, from the swings alone."""
    lever = spots.lever
    assert lever.reference_x_px is not None
    assert lever.reference_y_px is not None
    u = np.full(len(spots.times_s), spots.u_px)
    _, y_rad, _, u_y_rad = deflections(
        lever, spots.axes, spots.x_px, spots.y_px, u, u, (lever.reference_x_px, lever.reference_y_px)
    )
    times_ns = np.rint(spots.times_s * 1e9).astype(np.int64)
    swings = [
        swing for swing in swings_of(times_ns, y_rad, u_y_rad) if swing.amplitude > FINAL_ARCSEC * ARCSEC_RAD
    ]
    pendulum = pendulum_on_ball(0.406, 6.05e-3, MATERIALS["steel"], MATERIALS["glass_k8"])
    slow = slow_deflections(times_ns, y_rad, u_y_rad)
    fit = fit_exact(
        turning_points(settled_swings(swings, [slow], slow.unit, pendulum, FitSettings()).swings), pendulum
    )
    estimates = [fit.estimate(name) for name in PAPER.names()]
    return np.array([e.value for e in estimates]), np.array([e.standard_uncertainty for e in estimates])


def shifts(seed: int, rate_hz: float = 60.0, duration_s: float = 2400.0) -> dict[str, dict[str, float]]:
    """Shift of every parameter in the uncertainty claimed, by what was wrong; noise and truth alike."""
    rig = draw_rig(seed)
    truth = rig.settings
    axes = swing_for_axes(rig).axes
    ladder = climb_tilts(rig)
    true_lever = Lever(
        arm_m=truth.optics.arm_m,
        pixel_pitch_m=truth.sensor.pixel_pitch_m,
        reference_x_px=truth.optics.reference_x_px,
        reference_y_px=truth.optics.reference_y_px,
    )
    true_axes = Axes(
        slow_angle_rad=truth.axes.slow_angle_rad,
        non_orthogonality_rad=truth.axes.non_orthogonality_rad,
        mirrored=truth.axes.mirrored,
    )

    def spots(fast_arcsec: float) -> Spots:
        settings = truth.model_copy(
            update={
                "release": ReleaseTruth(amplitude_arcsec=124.0),
                "fast": FastModeTruth(amplitude_arcsec=fast_arcsec),
            }
        )
        motion = true_path(settings, duration_s, rate_hz)
        times_s = motion.times_ns * 1e-9
        same_noise = replace(rig, settings=settings, rng=np.random.default_rng([seed, 606]))
        x_px, y_px = spots_of(same_noise, motion.x_rad, motion.y_rad, times_s)
        return Spots(times_s, x_px, y_px, rig.noise_px, true_lever, true_axes)

    base, lively = spots(0.3), spots(3.0)
    assert base.lever.reference_x_px is not None
    rng = np.random.default_rng([seed, 707])
    t = base.times_s
    per_s = 1e-2 * np.cumsum(rng.standard_normal(len(t))) / math.sqrt(rate_hz)
    half = 0.5 * (truth.sensor.pixel_pitch_m / truth.optics.arm_m)

    def turned(angle_rad: float = 0.0, apart_rad: float = 0.0) -> Axes:
        return true_axes.model_copy(
            update={
                "slow_angle_rad": true_axes.slow_angle_rad + angle_rad,
                "non_orthogonality_rad": true_axes.non_orthogonality_rad + apart_rad,
            }
        )

    wrong = {
        "slow direction off by its u": (base, replace(base, axes=turned(angle_rad=axes.u_slow_angle_rad))),
        "fast direction off by its u, fast mode of 3 arcsec": (
            lively,
            replace(lively, axes=turned(apart_rad=axes.u_non_orthogonality_rad)),
        ),
        "origin off by its u": (
            base,
            replace(
                base,
                lever=true_lever.model_copy(
                    update={"reference_x_px": base.lever.reference_x_px + ladder.u_origin_px[0]}
                ),
            ),
        ),
        f"skew of the ladder's u, {ladder.u_skew:.2f}": (
            base,
            replace(base, lever=true_lever.model_copy(update={"skew": ladder.u_skew})),
        ),
        "skew of 0.03, a sensor askew by 1.7 degrees": (
            base,
            replace(base, lever=true_lever.model_copy(update={"skew": 0.03})),
        ),
        "gain off by 2 %": (base, replace(base, u_px=1.01 * base.u_px)),
        "pointing drifts by 1 arcsec/min": (
            base,
            replace(base, y_px=base.y_px + t / 60.0 * 2.0 * ARCSEC_RAD / (2.0 * half)),
        ),
        "pointing walks by 0.01 px in 1 s": (base, replace(base, y_px=base.y_px + per_s)),
        "frame times jitter by 15 µs": (
            base,
            replace(base, times_s=t + JITTER_S * rng.standard_normal(len(t))),
        ),
    }
    made = {id(base): _found(base), id(lively): _found(lively)}
    out = {}
    for name, (reference, changed) in wrong.items():
        value, _ = made[id(reference)]
        # in the uncertainty that is then claimed: what scatters more claims more
        moved, u = _found(changed)
        out[name] = dict(zip(PAPER.names(), ((moved - value) / u).tolist(), strict=True))
    return out
