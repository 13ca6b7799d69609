"""Light lever: geometry against hand calculation, ladders of tilts and shifts, checks of the scale."""

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.special import ndtr, stdtr

from calibration.ladder import LadderSteps, scale_posterior, solve_ladder
from calibration.lever_fit import check_scale, fit_ladder, lever_from_shifts, lever_from_tilts, moved_between
from calibration.light_lever import Lever, LeverGeometry, lever_from_geometry, trace_m
from processing.errors import DataError
from processing.units import ARCSEC_RAD
from tests.calibration.ladders import LADDERS, pull

PITCH_M = 4.8e-6
NOISE_PX = 0.01


def ladder(
    readings_arcsec: list[float], *, skew: float = 0.0, arm_m: float = 1.0, seed: int = 1
) -> LadderSteps:
    rng = np.random.default_rng(seed)
    reference = np.array(readings_arcsec) * ARCSEC_RAD
    t = np.tan(2 * reference)
    d_px = arm_m / PITCH_M * (t + skew * t**2)
    noise = NOISE_PX * rng.standard_normal((2, len(reference)))
    return made(np.array(readings_arcsec), noise[0], noise[1] - d_px)


@pytest.mark.parametrize("skew", [0.0, 0.05, -2.0])
def test_tilt_and_displacement_are_inverse(skew: float) -> None:
    lever = Lever(arm_m=1.3, pixel_pitch_m=PITCH_M, skew=skew)
    tilt = np.linspace(-0.01, 0.01, 41)
    np.testing.assert_allclose(lever.tilt_rad(lever.displacement_px(tilt)), tilt, rtol=1e-12, atol=1e-18)
    step = 1e-3
    d = lever.displacement_px(tilt)
    slope = (lever.tilt_rad(d + step) - lever.tilt_rad(d - step)) / (2 * step)
    np.testing.assert_allclose(lever.rad_per_px(d), slope, rtol=1e-6)


def made(readings_arcsec: np.ndarray, x: np.ndarray, y: np.ndarray) -> LadderSteps:
    """Of these settings and places, the settings without an uncertainty."""
    count = len(readings_arcsec)
    u = np.full(count, NOISE_PX)
    return LadderSteps(readings_arcsec * ARCSEC_RAD, np.zeros(count), 160 + x, 300 + y, u, u)


NINE = np.linspace(-120, 120, 9).tolist()


@pytest.mark.parametrize("kind", ["tilt", "shift"])
def test_three_settings_that_leave_no_hysteresis_to_be_told_from_a_skew(
    kind: Literal["tilt", "shift"],
) -> None:
    """The one setting that was approached from above: a singular matrix, or a scale of −8e4 ± 1e9."""
    steps = ladder([0, 0, 0, 100, 100, -100, -100, 0])
    found = fit_ladder(steps, kind)
    t = np.tan(2 * steps.reference) if kind == "tilt" else steps.reference
    assert found.scale == pytest.approx(-np.polyfit(t, steps.y_px, 1)[0], abs=3 * found.u_scale)
    assert found.u_scale < 0.02 * found.scale
    assert math.isnan(found.hysteresis)


def test_plain_geometry_is_the_plain_lever() -> None:
    plain = LeverGeometry(arm_m=1.0, u_arm_m=1e-3, pixel_pitch_m=PITCH_M, u_pixel_pitch_m=1e-9)
    found = lever_from_geometry(plain)
    assert found.lever.arm_m == pytest.approx(1.0, rel=1e-12)
    assert found.lever.skew == 0.0
    assert found.lever.u_arm_m == pytest.approx(1e-3, rel=1e-6)
    assert found.lever.u_scale_relative == pytest.approx(math.hypot(1e-3, 1e-9 / PITCH_M), rel=1e-6)


def test_the_trace_agrees_with_what_can_be_had_by_hand() -> None:

    def arm_m(**changed: float) -> float:
        return lever_from_geometry(LeverGeometry(arm_m=1.0, pixel_pitch_m=PITCH_M, **changed)).lever.arm_m

    # a mirror that recedes by R phi shifts the beam by 2 R phi sin(i): against 2 phi of the lever, R sin(i)
    rolled = arm_m(incidence_along_rad=0.2, ball_radius_m=6e-3)
    assert abs(rolled - arm_m(incidence_along_rad=0.2)) == pytest.approx(6e-3 * math.sin(0.2), rel=0.05)
    # square incidence: the ball's translation is without effect to first order
    assert arm_m(ball_radius_m=6e-3, u_ball_radius_m=1e-5) == pytest.approx(1.0, abs=1e-5)
    # incidence across the swing turns the beam by 2 phi cos(i)
    assert arm_m(incidence_across_rad=0.2) == pytest.approx(math.cos(0.2), rel=1e-6)
    # a sensor askew by theta: sin(2 phi)/cos(2 phi + theta)
    askew = LeverGeometry(arm_m=1.0, pixel_pitch_m=PITCH_M, sensor_tilt_along_rad=0.1)
    for tilt in (1e-3, -1e-3):
        exact = {math.sin(2 * tilt) / math.cos(2 * tilt + sign * 0.1) for sign in (1, -1)}
        assert any(trace_m(askew, tilt)[1] == pytest.approx(value, rel=1e-12) for value in exact)
    assert abs(lever_from_geometry(askew).lever.skew) == pytest.approx(math.tan(0.1), rel=1e-3)
    square = LeverGeometry(arm_m=1.0, pixel_pitch_m=PITCH_M, u_sensor_tilt_along_rad=0.02)
    assert lever_from_geometry(square).lever.u_skew == pytest.approx(0.02, rel=1e-3)


def test_a_bent_ladder_is_found_out_and_corrected() -> None:
    # 0.5 skew at 2000 arcsec: 2 % of 4000 px, far beyond 0.01 px of noise
    readings = np.linspace(-2000, 2000, 11).tolist()
    fit = fit_ladder(ladder(readings, skew=0.5), "tilt")
    assert fit.nonlinear
    assert abs(fit.skew - 0.5) < 4 * fit.u_skew
    lever = lever_from_tilts(fit, PITCH_M)
    assert abs(lever.arm_m - 1.0) < 4 * lever.u_arm_m
    assert lever.skew == fit.skew
    assert (lever.reference_x_px, lever.reference_y_px) == pytest.approx((160.0, 300.0), abs=0.1)
    straight = fit_ladder(ladder(readings), "tilt")
    assert not straight.nonlinear
    assert lever_from_tilts(straight, PITCH_M).skew == 0.0
    # two-sided, of a normal deviate; of Student's t where eleven steps, less origin, scale, skew, scatter
    z = abs(straight.skew) / straight.u_skew
    assert straight.chance_if_linear == pytest.approx(2 * ndtr(-z), rel=1e-3)
    noisy = ladder(readings)
    noisy = replace(noisy, y_px=noisy.y_px + 0.1 * np.random.default_rng(3).standard_normal(11))
    scattered = fit_ladder(noisy, "tilt")
    z = abs(scattered.skew) / scattered.u_skew
    assert scattered.chance_if_linear == pytest.approx(2 * stdtr(8, -z), rel=1e-3)


def test_a_ladder_that_hardly_determines_the_tilt_of_the_sensor_says_so() -> None:
    quiet = ladder(NINE)
    coarse = replace(quiet, u_reference=np.full(9, 0.1 * ARCSEC_RAD))
    assert not any("tilt of the sensor" in note for note in fit_ladder(quiet, "tilt").notes)
    assert any("tilt of the sensor" in note for note in fit_ladder(coarse, "tilt").notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "share", "beyond"),
    [
        ("straight, 9 steps to 150 arcsec", (0.6, 0.9), 0),
        ("cubic 3.6e-4, quiet", (0.5, 0.9), 1),
        ("wrong by 10 u, 5 steps to 60 arcsec", (0.65, 1.0), 1),
    ],
)
def test_what_may_have_bent_a_ladder_is_in_the_uncertainty_of_its_scale(
    name: str, share: tuple[float, float], beyond: int
) -> None:
    """Of 30 seeds; if a straight ladder is thought probable, 0.3 of those with a cubic part."""
    pulls = np.abs([pull(name, seed)[0] for seed in range(30)])
    assert share[0] <= np.mean(pulls < 1.0) <= share[1]
    assert np.count_nonzero(pulls > 3.0) <= beyond


def test_a_cubic_part_and_a_wrong_step_are_named() -> None:
    assert any("a cubic part" in note for note in pull("cubic 3.6e-3, 9 steps to 300 arcsec", 1)[2])
    assert not any("cubic" in note for note in pull("straight, 9 steps to 150 arcsec", 1)[2])
    steps = ladder(NINE)
    y_px = steps.y_px.copy()
    y_px[7] += 1.0
    x_px = steps.x_px + 0.1 * np.random.default_rng(4).standard_normal(9)
    fit = fit_ladder(replace(steps, x_px=x_px, y_px=y_px), "tilt")
    assert any("step 8 is probably wrong" in note for note in fit.notes)
    assert any("along the motion; a cubic part or a wrong step explains" in note for note in fit.notes)
    assert any("across the motion; uncertainties were enlarged" in note for note in fit.notes)
    assert int(np.argmax(np.abs(fit.residual_px[:, 1]))) == 7
    assert abs(fit.scale * PITCH_M - 1.0) < 3.0 * fit.u_scale * PITCH_M < 1e-3


def test_in_a_long_straight_ladder_no_step_is_probably_wrong() -> None:
    """A prior probability that had a lower limit made a wrong step of 120 the rule."""
    trace = solve_ladder(ladder(np.linspace(-120, 120, 120).tolist()), "tilt", None, fit_skew=False).trace
    assert scale_posterior(trace, "tilt", 1.0 / PITCH_M).p_wrong.sum() < 0.5


def test_a_residual_is_the_whole_departure_from_the_stated_setting() -> None:
    """Where the settings are less certain than the spot, the fit moves them; the residual showed a tenth."""
    steps = ladder(np.linspace(-60, 60, 5).tolist())
    u_reference = np.full(5, 0.1 * ARCSEC_RAD)
    y_px = steps.y_px.copy()
    y_px[3] += 4.0
    fit = fit_ladder(replace(steps, y_px=y_px, u_reference=u_reference), "tilt")
    # a straight line through five evenly spaced steps leaves 0.7 of an error of the fourth
    assert fit.residual_px[3, 1] == pytest.approx(0.7 * 4.0, abs=5 * NOISE_PX)
    assert any("step 4 at 30 arcsec does not fit" in note for note in fit.notes)


def test_the_uncertainty_of_a_cubic_part_is_its_scatter() -> None:
    """Of 16 seeds, within four of its own standard deviations; also where a wrong step may be the cause."""
    bent = LADDERS["cubic 3.6e-3, 9 steps to 300 arcsec"]
    fits = [fit_ladder(bent.climbed(seed), "tilt") for seed in range(16)]
    pulls = np.array([(fit.cubic - bent.cubic) / fit.u_cubic for fit in fits])
    assert abs(np.sqrt(np.mean(pulls**2)) - 1.0) < 4 / np.sqrt(2 * len(pulls))
    assert abs(np.mean(pulls)) < 4 / np.sqrt(len(pulls))


def test_hysteresis_and_direction_have_the_signs_of_the_motion() -> None:
    """The motion leans by 0.3 rad to the right; settings from below lie 0.4 arcsec above those from above."""
    up = np.linspace(-120.0, 120.0, 9)
    reference = np.concatenate([up, up[-2::-1]]) * ARCSEC_RAD
    way = np.repeat([1.0, -1.0], [9, 8])
    rng = np.random.default_rng(5)
    along = np.tan(2 * (reference + 0.5 * 0.4 * ARCSEC_RAD * way)) / PITCH_M
    x, y = NOISE_PX * rng.standard_normal((2, 17)) + np.outer([math.sin(0.3), -math.cos(0.3)], along)
    fit = fit_ladder(made(reference / ARCSEC_RAD, x, y), "tilt")
    assert fit.hysteresis == pytest.approx(0.4 * ARCSEC_RAD, abs=4 * fit.u_hysteresis)
    assert fit.hysteresis > 10 * fit.u_hysteresis
    assert fit.direction_rad == pytest.approx(0.3, abs=4 * fit.u_direction_rad)


def test_a_wrong_reference_enlarges_the_scale_s_uncertainty_alone() -> None:
    """What the reference is off moves the spot along the ladder: across it nothing is enlarged."""
    z, claimed = [], []
    for seed in range(20):
        steps = ladder(NINE, seed=seed)
        off = 0.3 * ARCSEC_RAD * np.random.default_rng([seed, 1]).standard_normal(9)
        fit = fit_ladder(replace(steps, reference=steps.reference + off), "tilt")
        assert fit.u_direction_rad < 2.0 * NOISE_PX / np.hypot.reduce(steps.y_px - steps.y_px.mean())
        z.append((fit.scale * PITCH_M - 1.0) / (fit.u_scale * PITCH_M))
        claimed.append(fit.scale_dof)
    assert set(claimed) <= {6.0, 7.0}, "a skew is taken for real once in a hundred"
    # Student's t of seven degrees of freedom has a variance of 7/5; an rms of 20 lies within 3/sqrt(40)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(np.sqrt(7 / 5), rel=3 / np.sqrt(40))


def test_degrees_of_freedom_and_doubt_of_the_skew_are_part_of_the_lever() -> None:
    quiet = fit_ladder(ladder(NINE), "tilt")
    assert lever_from_tilts(quiet, PITCH_M).arm_dof is None
    assert lever_from_tilts(quiet, PITCH_M).u_skew == quiet.u_skew
    noisy = ladder(NINE)
    noisy = replace(noisy, y_px=noisy.y_px + 0.05 * np.random.default_rng(2).standard_normal(9))
    plain = fit_ladder(noisy, "tilt")
    assert lever_from_tilts(plain, PITCH_M).arm_dof == pytest.approx(7.0)
    # Welch and Satterthwaite: a reference as uncertain as the ladder doubles the variance, and has no scatter
    same = fit_ladder(noisy, "tilt", u_reference_relative=plain.u_scale / plain.scale)
    assert (same.u_scale, same.scale_dof) == pytest.approx((math.sqrt(2) * plain.u_scale, 4 * 7.0))
    # tilts to one side mostly: a sensor askew by the doubt of its tilt would look like another scale
    lopsided = ladder(np.linspace(-10, 300, 9).tolist(), skew=0.05)
    fit = fit_ladder(replace(lopsided, u_reference=np.full(9, 0.02 * ARCSEC_RAD)), "tilt")
    assert not fit.nonlinear
    assert abs(fit.scale * PITCH_M - 1.0) < 2.0 * fit.u_scale * PITCH_M


def test_shifts_give_the_pitch() -> None:
    shift = np.linspace(-3e-4, 3e-4, 7)
    ones = np.ones(7)
    steps = LadderSteps(shift, 0 * ones, 100 + 0 * ones, 200 + shift / PITCH_M, 0.01 * ones, 0.01 * ones)
    fit = fit_ladder(steps, "shift")
    lever = lever_from_shifts(fit, 1.0, 1e-3)
    assert lever.u_pixel_pitch_m == pytest.approx(PITCH_M * fit.u_scale * PITCH_M, rel=1e-6)
    assert lever.pixel_pitch_m == pytest.approx(PITCH_M, rel=1e-9)
    assert lever.u_scale_relative > 1e-3


@pytest.mark.parametrize(
    ("readings", "words"),
    [
        ([-100.0, 100.0], "2 of the 5 steps"),
        ([20.0, 40.0, 60.0, 80.0, 100.0], "one sign"),
        ([-50.0, 50.0, -50.0, 50.0, -50.0], "different settings"),
        ([math.nan, -50.0, 0.0, 50.0, 100.0], "no reference"),
    ],
)
def test_a_ladder_that_cannot_serve_is_refused(readings: list[float], words: str) -> None:
    with pytest.raises(DataError, match=words):
        fit_ladder(ladder(readings), "tilt")


def test_a_spot_that_does_not_follow_is_refused() -> None:
    still = made(np.array(NINE), *0.01 * np.random.default_rng(3).standard_normal((2, 9)))
    with pytest.raises(DataError, match="does not follow"):
        fit_ladder(still, "tilt")


def test_a_lever_that_moved_is_flagged_and_what_both_checks_share_does_not_hide_it() -> None:
    lever = lever_from_tilts(fit_ladder(ladder(NINE, seed=5), "tilt"), PITCH_M)
    for arm_m, moved in ((1.0, False), (1.002, True)):
        assert check_scale(lever, fit_ladder(ladder(NINE, arm_m=arm_m, seed=6), "tilt")).moved is moved
    fit = fit_ladder(ladder(NINE, seed=6), "tilt")
    halved = check_scale(lever.model_copy(update={"arm_m": 2.0, "u_arm_m": 0.0}), fit)
    assert halved.ratio == pytest.approx(0.5, rel=1e-3)
    assert halved.u_both == halved.u_ratio == pytest.approx(0.5 * fit.u_scale * PITCH_M, rel=1e-3)
    assert moved_between((2.0, 5e-3), (2.0, 5e-3), 2e-3)[1] == pytest.approx(math.sqrt(2 * (25 - 16)) * 1e-3)
    assert moved_between((1.0, 1.01e-3), (1.002, 1.01e-3))[2] is False
    assert moved_between((1.0, 1.01e-3), (1.002, 1.01e-3), 1e-3)[2] is True
