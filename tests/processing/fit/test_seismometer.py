"""An auxiliary seismometer beside the exact fit: what it saves, and what must not help."""

import gzip
from functools import cache

import numpy as np
import pytest

from acquisition.simulation.ground import SimulatedSeismometer
from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import noisy, true_path
from processing.arrays import Floats
from processing.estimate import Estimate
from processing.fit import FitResult, Seismogram, fit_exact, fit_with_seismometer
from processing.fit.exact_model import DiscrepancyColumns, ExactModel
from processing.fit.seismometer import SeismometerFit, SeismometerVerdict
from processing.swing import TurningPoints, half_cycles_of, turning_points
from processing.units import ARCSEC_RAD
from tests.processing.fit.decays import paper_pair, pulls, with_noise
from tests.processing.fit.driven import driven_path
from tests.shared_data import SHARED_DATA

PARAMETERS, PENDULUM = paper_pair("glass_k8")
Q = 1e-7
STEP_S = 0.1
UNIT = 1e9
"""Counts of the seismometer for 1 rad/s^2."""
SEISMOMETERS = SHARED_DATA / "ground" / "two-seismometers.csv.gz"


def white(seed: int) -> Floats:
    return np.asarray(Q * np.sqrt(0.5 / STEP_S) * np.random.default_rng(seed).standard_normal(12_000))


CLOCK: Floats = STEP_S * np.arange(12_000, dtype=np.float64)


def decay(time_s: Floats, drive: Floats, last_arcsec: float = 15.0) -> tuple[TurningPoints, FitResult]:
    """Turning points with noise, and the fit without a seismometer."""

    def forcing(t: Floats) -> Floats:
        return np.interp(t, time_s, drive, left=0.0, right=0.0)

    time, turn, _ = driven_path(PARAMETERS, PENDULUM, q=0.0, seed=0, last_arcsec=last_arcsec, forcing=forcing)
    points = with_noise(time, np.abs(turn), PARAMETERS.period0_s, 0.005, np.random.default_rng(1))
    return points, fit_exact(points, PENDULUM, averaged=False)


@cache
def on_white() -> tuple[TurningPoints, FitResult]:
    return decay(CLOCK, white(3))


def beside(seen: Seismogram) -> SeismometerFit:
    """The fit to the decay on white ground with this seismometer."""
    points, alone = on_white()
    return fit_with_seismometer(points, PENDULUM, seen, alone, averaged=False)


def seismometer(value: Floats, time_s: Floats = CLOCK) -> Seismogram:
    return Seismogram(time_s, UNIT * value.reshape(len(time_s), -1), ("E", "N")[: value.ndim])


@cache
def with_all_of_the_drive() -> SeismometerFit:
    return beside(seismometer(white(3)))


def test_what_it_explains_is_taken_off_and_its_response_found() -> None:
    (_, alone), found = on_white(), with_all_of_the_drive()
    assert found.use.used
    assert min(found.use.saved.values()) > 20
    assert np.max(np.abs(pulls(found.fit, PARAMETERS))) < 4
    (response,) = found.use.responses
    assert response.gain * UNIT == pytest.approx(1.0, abs=0.02)
    assert response.phase_rad == pytest.approx(0.0, abs=0.02)
    assert found.use.explained > 0.999
    assert abs(found.use.delay_s.value) < 4 * found.use.delay_s.standard_uncertainty < 0.4
    # the residuals that are left are white, and the law's parameters alone are reported
    assert found.fit.names == alone.names
    assert found.fit.chi2_per_dof == pytest.approx(1.0, abs=0.25)
    assert found.fit.dof == alone.dof - 2


def test_derivatives_by_errors_of_the_law_know_nothing_of_the_seismometer() -> None:
    """The filter has columns of the drive for all that it derives by, zero but for the seismometer itself."""
    fit = with_all_of_the_drive().fit
    model, columns = ExactModel.of(on_white()[0], PENDULUM, fit)

    def errors(amplitude: Floats, _: Floats) -> Floats:
        return np.ones((len(amplitude), 64))

    found = model.filtered(columns, model.noise_of(fit), errors=DiscrepancyColumns(errors, errors))
    by_law, by_errors = np.split(found.jacobian, [len(columns)], axis=1)
    assert np.array_equal(by_law, model.filtered(columns, model.noise_of(fit)).jacobian)
    # all of a kind are the same error
    losses, durations = np.split(by_errors, 2, axis=1)
    assert np.all(losses == losses[:, :1])
    assert np.all(durations == durations[:, :1])


def test_its_own_noise_leaves_what_it_must() -> None:
    found = beside(seismometer(white(3) + white(4)))
    (response,) = found.use.responses
    # Wiener's gain, and half of the drive's power
    assert response.gain * UNIT == pytest.approx(0.5, abs=0.1)
    assert found.use.explained == pytest.approx(0.5, abs=0.1)
    assert found.use.saved["b"] == pytest.approx(np.sqrt(2), rel=0.15)


@pytest.mark.parametrize("seed", range(5, 8))
def test_one_that_is_unrelated_is_refused_and_changes_nothing(seed: int) -> None:
    found = beside(seismometer(white(seed)))
    assert found.use.verdict is SeismometerVerdict.NO_GAIN
    assert found.fit is on_white()[1]


def test_of_two_components_the_unrelated_one_is_left_out() -> None:
    found = beside(seismometer(np.column_stack([white(5), white(3)])))
    assert [response.name for response in found.use.responses] == ["N"]


def test_one_of_another_hour_and_samples_too_far_apart_are_refused() -> None:
    found = beside(seismometer(white(3), CLOCK + 1e5))
    assert found.use.verdict is SeismometerVerdict.ABSENT
    assert "do not overlap" in found.use.reason
    assert found.fit is on_white()[1]
    coarse = beside(Seismogram(CLOCK[::20], white(3)[::20, None], ("Z",)))
    assert coarse.use.reason.startswith("the seismometer has a sample every 2 s")


def test_a_delay_and_a_drift_of_its_clock_are_found() -> None:
    middle_s = 0.5 * on_white()[0].time_s[-1]
    use = beside(seismometer(white(3), CLOCK + 0.3 + 1e-3 * (CLOCK - middle_s))).use
    assert use.delay_s.value == pytest.approx(-0.3, abs=4 * use.delay_s.standard_uncertainty)
    assert use.clock_drift.value == pytest.approx(-1e-3, abs=4 * use.clock_drift.standard_uncertainty)
    assert use.saved["b"] > 10


def test_a_gap_costs_what_is_not_known() -> None:
    value = white(3)
    value[(CLOCK > 100) & (CLOCK < 160)] = np.nan
    found = beside(seismometer(value))
    whole = with_all_of_the_drive()
    assert 31 <= found.use.missing_half_cycles <= 36
    assert found.use.used
    assert 5 < found.use.saved["b"] < 0.95 * whole.use.saved["b"]
    assert np.max(np.abs(pulls(found.fit, PARAMETERS))) < 4


@pytest.mark.skipif(not SEISMOMETERS.exists(), reason="the recorded ground is not on this machine")
def test_a_real_seismometer_of_unknown_response_tells_what_drove_the_pendulum() -> None:
    with gzip.open(SEISMOMETERS) as file:
        time, known, unknown = np.loadtxt(file, delimiter=",", skiprows=1).T
    # counts of the known one are a velocity; it drives the pendulum with about 1e-7 rad/s^2/sqrt(Hz)
    acceleration = np.gradient(known, 0.1)
    points, alone = decay(time - 100.0, 6e-8 / np.std(acceleration) * acceleration, last_arcsec=8.0)
    counts = Seismogram(time - 100.0, unknown[:, None], ("counts",))
    found = fit_with_seismometer(points, PENDULUM, counts, alone, averaged=False)
    assert 3e-8 < alone.ground.density_rad_per_s2_rthz.value < 3e-7
    assert min(found.use.saved.values()) > 10
    assert np.max(np.abs(pulls(found.fit, PARAMETERS))) < 4
    # velocity leads the acceleration by a quarter, up to the sign of the side
    assert abs(found.use.responses[0].phase_rad) == pytest.approx(np.pi / 2, abs=0.3)
    assert found.use.responses[0].with_slope


def delay_found(seed: int, late_s: float) -> Estimate:
    """Of a seismometer that is late, beside turning points that the detector has found in samples."""
    settings = SimulationSettings.model_validate(
        {
            "seed": seed,
            "ground": {"model": "white", "white_m_per_s2_per_sqrt_hz": 2e-5},
            "seismometer": {"noise_m_per_s2_per_sqrt_hz": 1e-12, "delay_s": late_s},
            "fast": {"amplitude_arcsec": 0.0},
            "axes": {"leakage": 0.0},
        }
    )
    noise_rad = 0.02 * ARCSEC_RAD
    path = noisy(true_path(settings, 900.0, frame_rate_hz=50.0), noise_rad, noise_rad, seed)
    u = np.full(len(path.times_ns), noise_rad)
    half_cycles = half_cycles_of(path.times_ns, path.y_rad, u)
    points = turning_points(half_cycles)
    begin_s = next(1e-9 * one.turn_time_ns for one in half_cycles if not one.flags)
    felt = SimulatedSeismometer(settings).until(900.0, 0)
    seen = Seismogram(felt.time_s - begin_s, felt.counts[:, :1], ("along",))
    found = fit_with_seismometer(points, PENDULUM, seen, fit_exact(points, PENDULUM))
    assert found.use.used
    return found.use.delay_s


@pytest.mark.slow
def test_a_delay_beside_turning_points_that_were_measured_is_not_biased() -> None:
    """A detector knows the equilibrium from earlier half-cycles: what looks back only is like a delay."""
    found = [delay_found(seed, 0.05) for seed in (1, 2)]
    mean = np.mean([one.value for one in found])
    u_mean = np.mean([one.standard_uncertainty for one in found]) / np.sqrt(len(found))
    # both have what is not known of the measurement in their uncertainty, 0.06 s
    assert min(one.standard_uncertainty for one in found) > 0.06
    assert u_mean < 0.05
    assert abs(mean + 0.05) < 0.09
