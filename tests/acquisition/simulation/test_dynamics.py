"""The simulated pendulum agrees with an independent integration at tight tolerance; conserved quantities."""

import math
from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from acquisition.simulation.equation_of_motion import ModeConstants
from acquisition.simulation.motion import (
    ARCSEC_RAD,
    Motion,
    contact_radius_m,
    fast_mode,
    motions,
    slow_mode,
)
from acquisition.simulation.settings import ContactTruth, SimulationSettings
from acquisition.simulation.true_path import noisy, true_path, true_turning_points
from processing.errors import ConfigurationError

GLASS: dict[str, Any] = {}
SILICON: dict[str, Any] = {
    "b": 7.06e-4,
    "p": 0.815,
    "c": 3.84e-9,
    "n": 0.552,
    "period0_s": 4.072,
    "gamma_pa": 290.69e6,
    "flat_youngs_modulus_pa": 1.31e11,
    "flat_poisson_ratio": 0.266,
}
STEEL: dict[str, Any] = {
    "b": 7.961e-4,
    "p": 0.85,
    "c": 6.601e-9,
    "n": 0.461,
    "period0_s": 4.049,
    "gamma_pa": 95.46e6,
    "flat_youngs_modulus_pa": 2.11e11,
    "flat_poisson_ratio": 0.28,
}


def reference_turns(mode: ModeConstants, angle_rad: float, count: int) -> NDArray[np.float64]:
    """Times and angles of turning points by scipy's DOP853, stopped at each zero and each turn."""

    def motion(direction: float):  # type: ignore[no-untyped-def]
        def derivative(_: float, state: NDArray[np.float64]) -> list[float]:
            phi, rate = state
            size = abs(phi)
            elastic = mode.kappa * size ** (mode.n + 1) * (math.pi / 2 - mode.ball_over_contact_radius * size)
            friction = mode.c + mode.b * size**mode.p
            forces = -phi + math.copysign(elastic, phi) - friction * direction - mode.drag_s * rate
            return [rate, mode.w0_rad_per_s**2 * forces]

        return derivative

    time_s, state = 0.0, np.array([angle_rad, 0.0])
    direction = -math.copysign(1.0, angle_rad)
    found = []
    half_s = 2 * math.pi / mode.w0_rad_per_s
    while len(found) < count:
        for entry in (0, 1):

            def event(_: float, state: NDArray[np.float64], entry: int = entry) -> float:
                return float(state[entry])

            event.terminal = True  # type: ignore[attr-defined]
            event.direction = direction if entry == 0 else -direction  # type: ignore[attr-defined]
            answer = scipy.integrate.solve_ivp(
                motion(direction),
                (time_s, time_s + half_s),
                state,
                method="DOP853",
                rtol=1e-13,
                atol=1e-20,
                first_step=1e-6 * half_s,
                events=event,
            )
            time_s = answer.t_events[0][0]
            state = answer.y_events[0][0]
            state[entry] = 0.0
        found.append((time_s, state[0]))
        direction = -direction
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contact", "amplitude_arcsec"),
    [
        *((GLASS, 124.0), (GLASS, 3.0), (SILICON, 3.0), (STEEL, 124.0)),
        *(({"drag_s": 1e-4}, 124.0), ({"b": 1e-5, "p": 0.4, "n": 0.0}, 3.0)),
    ],
)
def test_turning_points_agree_with_an_independent_integrator(
    contact: dict[str, Any], amplitude_arcsec: float
) -> None:
    truth = SimulationSettings.model_validate(
        {"contact": contact, "release": {"amplitude_arcsec": amplitude_arcsec}}
    )
    found = true_turning_points(truth, final_amplitude_arcsec=0.1)
    wanted = reference_turns(slow_mode(truth.contact), amplitude_arcsec * ARCSEC_RAD, 15)
    assert found.angle_rad[1:16] == pytest.approx(wanted[:, 1], rel=1e-9)
    assert found.time_s[1:16] == pytest.approx(wanted[:, 0], rel=1e-9)


@pytest.mark.slow
def test_whole_run_agrees_with_an_independent_integrator() -> None:
    """With eight times the friction, so that it is soon over."""
    truth = SimulationSettings.model_validate({"contact": {"b": 8 * 37.33e-4}})
    found = true_turning_points(truth)
    assert len(found.time_s) > 40
    wanted = reference_turns(slow_mode(truth.contact), 124.0 * ARCSEC_RAD, len(found.time_s) - 1)
    assert found.angle_rad[1:] == pytest.approx(wanted[:, 1], rel=1e-9)
    assert found.time_s[1:] == pytest.approx(wanted[:, 0], rel=1e-9)


def test_dense_output_agrees_with_an_independent_integrator() -> None:
    """Between the steps' ends too: a quarter swing from the release, by scipy's own dense output."""
    mode = slow_mode(ContactTruth())
    start = 124.0 * ARCSEC_RAD
    times_s = np.linspace(0.0, 0.99, 400)
    angles, rates = Motion(mode, start, 0.0, 0.0, start).sample(times_s)

    def derivative(_: float, state: NDArray[np.float64]) -> list[float]:
        phi, rate = state
        elastic = mode.kappa * phi ** (mode.n + 1) * (math.pi / 2 - mode.ball_over_contact_radius * phi)
        return [rate, mode.w0_rad_per_s**2 * (-phi + elastic + mode.c + mode.b * phi**mode.p)]

    wanted = scipy.integrate.solve_ivp(
        derivative, (0, 1), [start, 0.0], method="DOP853", rtol=1e-13, atol=1e-18, t_eval=times_s
    ).y
    assert np.abs(angles - wanted[0]).max() < 1e-9 * start
    assert np.abs(rates - wanted[1]).max() < 1e-8 * start * mode.w0_rad_per_s


def test_without_losses_and_elasticity_it_is_a_cosine() -> None:
    mode = ModeConstants(1.5, 0.0, 1.0, 0.0, 0.0, 0.0, 91.0, 0.0)
    times_s = np.linspace(0, 1200, 20_001)
    angles, rates = Motion(mode, 6e-4, 0.0, 0.0, 6e-4).sample(times_s)
    assert np.abs(angles - 6e-4 * np.cos(1.5 * times_s)).max() < 1e-9 * 6e-4
    assert np.abs(rates + 9e-4 * np.sin(1.5 * times_s)).max() < 1e-8 * 9e-4


def test_constant_friction_takes_two_c_a_half_swing_and_then_holds() -> None:
    mode = ModeConstants(1.5, 0.0, 1.0, 1e-5, 0.0, 0.0, 91.0, 0.0)
    motion = Motion(mode, 1.05e-4, 0.0, 0.0, 0.0)
    turns = motion.advance(1e6)
    # Coulomb: every swing ends 2 c lower, until less than c is left
    assert np.abs(turns[:, 1]) == pytest.approx([0.85e-4, 0.65e-4, 0.45e-4, 0.25e-4, 0.05e-4], rel=1e-9)
    assert np.diff(turns[:, 0]) == pytest.approx(np.full(4, math.pi / 1.5), rel=1e-9)
    assert motion.at_rest
    assert motion.sample(np.array([1e3, 1e5]))[0] == pytest.approx([-0.05e-4] * 2, rel=1e-9)
    # friction may stop it before zero
    motion = Motion(mode, 1.5e-5, 0.0, 0.0, 0.0)
    assert motion.advance(1e6)[:, 1] == pytest.approx([0.5e-5], rel=1e-9)
    assert motion.at_rest


@settings(max_examples=40, deadline=None)
@given(
    b=st.floats(0, 2e-2),
    p=st.floats(0.2, 2.5),
    c=st.floats(0, 1e-6),
    n=st.floats(0, 1.5),
    gamma_pa=st.floats(0, 5e7),
    amplitude_arcsec=st.floats(0.5, 1000),
    pieces=st.integers(1, 9),
)
def test_amplitude_never_grows_and_asking_in_pieces_changes_nothing(
    b: float, p: float, c: float, n: float, gamma_pa: float, amplitude_arcsec: float, pieces: int
) -> None:
    truth = SimulationSettings.model_validate(
        {
            "contact": {"b": b, "p": p, "c": c, "n": n, "gamma_pa": gamma_pa},
            "release": {"amplitude_arcsec": amplitude_arcsec},
        }
    )
    times_s = np.linspace(0, 60, 1000)
    whole = motions(truth)[1].sample(times_s)[0]
    in_pieces = motions(truth)[1]
    assert np.array_equal(
        np.concatenate([in_pieces.sample(t)[0] for t in np.array_split(times_s, pieces)]), whole
    )
    turns = motions(truth)[1].advance(60.0)[:, 1]
    assert np.all(np.diff(np.abs(turns)) <= 1e-12 * np.abs(turns[:-1]))
    # friction may stop the last swing before zero
    assert np.all(turns[:-2] * turns[1:-1] <= 0)


def test_held_before_the_release_and_pushed_from_rest() -> None:
    held = motions(SimulationSettings.model_validate({"release": {"at_s": 5.0}}))[1]
    assert held.sample(np.array([0.0, 2.5, 5.0]))[0] == pytest.approx([124 * ARCSEC_RAD] * 3, rel=1e-15)
    assert held.sample(np.array([5.5]))[0][0] < 124 * ARCSEC_RAD
    pushed = SimulationSettings.model_validate({"release": {"at_s": 5.0, "way": "push"}})
    assert motions(pushed)[1].sample(np.array([0.0, 5.0]))[0] == pytest.approx([0.0, 0.0], abs=1e-18)
    first_rad = true_turning_points(pushed).angle_rad[0]
    # elasticity softens by 2 %, friction takes 0.4 %: the amplitude is near the stated one, not equal
    assert first_rad == pytest.approx(124 * ARCSEC_RAD, rel=0.03)


def test_push_in_mid_swing_changes_the_rate_at_once_and_only_from_there() -> None:
    mode = slow_mode(ContactTruth())
    start = 50 * ARCSEC_RAD
    before = np.linspace(0, 3.0, 50)
    plain = Motion(mode, start, 0.0, 0.0, start)
    pushed = Motion(mode, start, 0.0, 0.0, start)
    assert np.array_equal(plain.sample(before)[0], pushed.sample(before)[0])
    pushed.kick(3.0, 1e-4)
    angle, rate = pushed.sample(np.array([3.0, 3.0 + 1e-6]))
    wanted, slow_rate = plain.sample(np.array([3.0, 3.0 + 1e-6]))
    assert angle[0] == pytest.approx(wanted[0], abs=1e-12 * start)
    assert rate[1] - slow_rate[1] == pytest.approx(1e-4, rel=1e-4)


def test_fast_mode_obeys_the_same_laws_faster() -> None:
    contact = ContactTruth()
    mode = fast_mode(contact, SimulationSettings().fast)
    assert mode.w0_rad_per_s == pytest.approx(5 * slow_mode(contact).w0_rad_per_s)
    turns = Motion(mode, 1e-4, 0.0, 0.0, 0.0).advance(20.0)
    slow_turns = Motion(slow_mode(contact), 1e-4, 0.0, 0.0, 0.0).advance(100.0)
    assert turns[:40, 1] == pytest.approx(slow_turns[:40, 1], rel=1e-9)
    assert turns[:40, 0] * 5 == pytest.approx(slow_turns[:40, 0], rel=1e-9)


@pytest.mark.parametrize(("contact", "radius_um"), [(GLASS, 66.18), (SILICON, 59.16), (STEEL, 54.04)])
def test_contact_radius_is_that_of_table_1(contact: dict[str, Any], radius_um: float) -> None:
    assert contact_radius_m(ContactTruth.model_validate(contact)) * 1e6 == pytest.approx(radius_um, abs=0.006)
    assert contact_radius_m(ContactTruth(contact_radius_m=5e-5)) == 5e-5


def test_adhesion_stronger_than_gravity_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="gamma_pa"):
        motions(SimulationSettings.model_validate({"contact": {"gamma_pa": 1e9}}))


def test_memory_stays_flat_over_a_day() -> None:
    _, slow = motions(SimulationSettings())
    for hour in range(24):
        angles, _ = slow.sample(np.linspace(hour * 3600.0, hour * 3600.0 + 3599.0, 100))
        assert np.all(np.isfinite(angles))
    assert slow._steps.nbytes < 100_000
    assert slow.at_rest


def test_noisy_trajectories_have_their_noise_and_their_seed() -> None:
    truth = true_path(SimulationSettings(), 100.0, 100.0)
    assert len(truth.times_ns) == 10_001
    assert truth.times_ns[1] == 10_000_000
    one = noisy(truth, 1e-8, 2e-8, seed=3)
    again = noisy(truth, 1e-8, 2e-8, seed=3)
    other = noisy(truth, 1e-8, 2e-8, seed=4)
    assert np.array_equal(one.y_rad, again.y_rad)
    assert not np.array_equal(one.y_rad, other.y_rad)
    for noise, u_rad in ((one.x_rad - truth.x_rad, 1e-8), (one.y_rad - truth.y_rad, 2e-8)):
        assert noise.std() == pytest.approx(u_rad, rel=4 / math.sqrt(2 * 10_000))
        assert abs(noise.mean()) < 4 * u_rad / math.sqrt(10_000)
    # four standard deviations of a correlation coefficient
    assert abs(np.corrcoef(one.x_rad - truth.x_rad, one.y_rad - truth.y_rad)[0, 1]) < 4 / 100
