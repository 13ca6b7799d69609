"""Turning points determined with the fitted motion reach the Cramer-Rao bound and are independent."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from processing.deflections import Deflections, slow_deflections
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.evidence import Evidence
from processing.fit.exact import fit_exact
from processing.fit.refinement import (
    DecayFit,
    describes_as_well,
    fitted_twice,
    judge_refinement,
    known_motion,
    measurement_shift,
    second_measurement,
    with_enlarged_u,
)
from processing.swing import estimate_scatter, half_cycles_of_blocks, turning_points
from processing.units import ARCSEC_RAD
from tests.processing.fit.decays import paper_pair, pulls
from tests.processing.fit.driven import driven_path
from tests.processing.swing.truth import PX_PER_RAD, Record, contact_decay, detect, errors, rms

EARLY = 40
NOISE_RAD = 0.02 / PX_PER_RAD


def in_rad(record: Record) -> Record:
    """A record in px as one in rad."""
    in_px = ("deflection", "u_deflection", "turn_amplitude")
    return replace(record, **{name: getattr(record, name) / PX_PER_RAD for name in in_px})


def noisy(clean: Record, seed: int) -> Record:
    """A record in rad with noise of 0.02 px."""
    noise = np.random.default_rng([seed, 404]).standard_normal(len(clean.deflection))
    return replace(clean.plus(NOISE_RAD * noise), u_deflection=np.full(len(noise), NOISE_RAD))


def in_blocks(record: Record) -> Iterator[Deflections]:
    """The samples of a record, 1,000 at a time."""
    for first in range(0, len(record.times_ns), 1000):
        part = slice(first, first + 1000)
        yield slow_deflections(record.times_ns[part], record.deflection[part], record.u_deflection[part])


@pytest.fixture(scope="module")
def glass() -> Record:
    return in_rad(contact_decay("glass_k8", 320))


@pytest.mark.parametrize("contact", ["glass_k8", "silicon", "steel"])
@pytest.mark.parametrize("reference_arcsec", [124.0, 10.0])
def test_known_motion_is_that_of_the_integrated_equation(contact: str, reference_arcsec: float) -> None:
    """Of samples without noise nothing is left: whatever the amplitude that it is written down about."""
    record = in_rad(contact_decay(contact, 30))
    motion = known_motion(*paper_pair(contact), reference_arcsec * ARCSEC_RAD)
    found = errors(record, second_measurement(detect(record), in_blocks(record), motion))
    assert len(found) >= 29
    # stated noise 1e-3 px, bound 1e-4 px of 250; the waveform's table and a centre to be found leave less
    assert np.abs(found.amplitude_to_crlb).max() < 1.0
    assert np.abs(found.time_to_crlb).max() < 0.5


@pytest.mark.slow
def test_early_half_cycles_stand_at_the_bound_and_apart(glass: Record) -> None:
    rows: list[np.ndarray] = []
    detected: list[float] = []
    measured_again: list[float] = []
    for seed in range(3):
        record = noisy(glass, seed)
        half_cycles = detect(record)
        pendulum = paper_pair("glass_k8")[1]
        exact = fit_exact(turning_points(half_cycles), pendulum)
        motion = known_motion(exact.parameters, pendulum, half_cycles[0].amplitude)
        again = second_measurement(half_cycles, in_blocks(record), motion)
        assert measurement_shift(half_cycles, again).complete
        for found, shifts in (
            (errors(record, half_cycles), detected),
            (errors(record, again), measured_again),
        ):
            early = (found.index > 0) & (found.index <= EARLY)
            # independent errors leave a unit normal deviate
            shifts.append(float(found.time[early].sum() / np.sqrt(early.sum())))
        to_crlb = (found.amplitude_to_crlb, found.time_to_crlb)
        rows.append(np.column_stack([found.amplitude, found.time, *to_crlb])[early])
    table = np.concatenate(rows)
    scatter = 4.0 / np.sqrt(2.0 * len(table))
    for z, to_bound in zip(table[:, :2].T, table[:, 2:].T, strict=True):
        assert 0.95 - scatter < rms(z) < 1.05 + scatter
        assert abs(z.mean()) < 0.1 + 4.0 / np.sqrt(len(table))
        assert rms(to_bound) < 1.06 + scatter
    # the root mean square of 3 unit deviates, + 4 of its standard deviation
    assert rms(np.array(measured_again)) < 1.0 + 4.0 / np.sqrt(6.0)
    assert rms(np.array(detected)) > 2.0, "what measuring again is for"


def test_flagged_ones_stay_and_those_that_are_gone_are_flagged(glass: Record) -> None:
    record = noisy(glass, 3)
    half_cycles = detect(record)
    half_cycles[20] = replace(half_cycles[20], flags=2)
    hidden = record.deflection.copy()
    turn_s = half_cycles[50].turn_time_ns * 1e-9
    hidden[np.abs(record.time_s - turn_s) < 0.6] = np.nan
    motion = known_motion(*paper_pair("glass_k8"), half_cycles[0].amplitude)
    again = second_measurement(half_cycles, in_blocks(replace(record, deflection=hidden)), motion)
    assert [h.index for h in again] == [h.index for h in half_cycles]
    assert again[20] == half_cycles[20]
    assert again[50].flags != 0
    assert again[52].flags == 0
    assert np.isnan(again[21].half_period_s) == (again[20].index != again[21].index - 1)


def test_a_waveform_that_is_not_that_of_the_motion_is_refused(glass: Record) -> None:
    parameters, pendulum = paper_pair("glass_k8")
    record = noisy(glass, 5)
    half_cycles = detect(record)
    # the same loss at 60 arcsec, but constant: the turning times of every half-cycle would shift
    constant = replace(parameters, c=parameters.b * (60 * ARCSEC_RAD) ** parameters.p, b=1e-9)
    motion = known_motion(constant, pendulum, half_cycles[0].amplitude)
    again = second_measurement(half_cycles, in_blocks(record), motion)
    first = fit_exact(turning_points(half_cycles), pendulum)
    second = fit_exact(turning_points(again), pendulum)
    assert not describes_as_well(second, first)
    shift = measurement_shift(half_cycles, again)
    wider = with_enlarged_u(half_cycles, shift)
    assert wider[5].u_turn_time_s == pytest.approx(np.hypot(1.0, shift.time) * half_cycles[5].u_turn_time_s)
    assert wider[5].turn_time_ns == half_cycles[5].turn_time_ns


def test_a_second_measurement_that_finds_no_half_cycle_states_no_shift(glass: Record) -> None:
    parameters, pendulum = paper_pair("glass_k8")
    half_cycles = detect(noisy(glass, 5))
    motion = known_motion(parameters, pendulum, half_cycles[0].amplitude)
    lost = [replace(h, flags=2) for h in half_cycles]
    first = fit_exact(turning_points(half_cycles), pendulum)
    found = judge_refinement(half_cycles, lost, motion, first, DecayFit(pendulum))
    assert found.doubt == "the turning points stand as detected (none of the half-cycles was found again)"
    assert found.half_cycles == half_cycles


def test_a_pendulum_that_would_not_swing_is_refused() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    with pytest.raises(DataError, match="no swing"):
        known_motion(replace(parameters, gamma_pa=100 * parameters.gamma_pa), pendulum, 124 * ARCSEC_RAD)


def test_a_shift_that_all_turning_points_share_makes_none_more_uncertain(glass: Record) -> None:
    """The start of the motion takes it in: a motion fitted to few half-cycles is late by a millisecond."""
    half_cycles = detect(noisy(glass, 3))
    late = [replace(h, turn_time_ns=h.turn_time_ns + 1_400_000) for h in half_cycles]
    shift = measurement_shift(half_cycles, late)
    assert (shift.time, shift.amplitude) == (0.0, 0.0)
    early = [replace(h, turn_time_ns=h.turn_time_ns + (1_400_000 if h.side > 0 else 0)) for h in half_cycles]
    assert measurement_shift(half_cycles, early).time > 10.0


@pytest.mark.parametrize(("q", "seed"), [(8e-9, 4), (3e-8, 2)])
def test_a_drive_that_passes_for_a_rest_position_that_moves_loses_no_second_measurement(
    q: float, seed: int
) -> None:
    """Its uncertainties were 10 to 30 times too large.

    Times are stamps of a host, 1 ms off: what that does to the samples is in their uncertainties.
    """
    parameters, pendulum = paper_pair("glass_k8", 1.7e-3)
    path = driven_path(parameters, pendulum, q=q, seed=seed, frames_per_s=25.0)[2]
    position = path + 0.005 * ARCSEC_RAD * np.random.default_rng([seed, 3]).standard_normal(len(path))
    late_s = 1e-3 * np.random.default_rng([seed, 5]).standard_normal(len(path))
    time_s = np.sort(np.arange(len(path)) / 25.0 + late_s)
    times_ns = np.rint(1e9 * (time_s - time_s[0])).astype(np.int64)
    scatter = estimate_scatter(times_ns, position)
    assert scatter.jitter_s == pytest.approx(1e-3, rel=0.1)
    samples = slow_deflections(times_ns, position, scatter.u_deflection)
    known = Evidence(drag_s=Estimate(1.7e-3, 1e-5))
    half_cycles = half_cycles_of_blocks([samples])
    found, fit = fitted_twice(half_cycles, [samples], DecayFit(pendulum, evidence=known))
    assert found.doubt == ""
    assert found.motion is not None
    assert 0.8 < fit.chi2_per_dof < 1.2
    assert np.all(np.abs(pulls(fit, parameters, "b", "c", "period0_s")) < 3)
