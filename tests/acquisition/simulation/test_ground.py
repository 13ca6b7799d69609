"""The ground under the simulated pendulum: spectra, the oscillator's response, seeds, files."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from acquisition.simulation.ground import FAST, SLOW, GroundMotion, acceleration_density, ground_of
from acquisition.simulation.motion import motions
from acquisition.simulation.settings import ARCSEC_RAD, GroundTruth, SimulationSettings
from acquisition.simulation.smooth_series import BLOCK_KNOTS, SmoothSeries
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.errors import ConfigurationError
from processing.noise_models import nhnm_db, nlnm_db
from tests.shared_data import SHARED_DATA

PERIOD_S = 4.071
W0 = 2 * math.pi / PERIOD_S
PER_ACCELERATION = 2e-4 / (9.80665 * 6.05e-3)
"""Angle per acceleration, d/(g R), in rad s^2/m."""
NO_FRICTION = {"b": 0.0, "c": 0.0, "gamma_pa": 0.0, "period0_s": PERIOD_S}
SHARED = SHARED_DATA / "ground"


def rig(**changes: Any) -> SimulationSettings:
    return SimulationSettings.model_validate(changes)


def moving(settings: SimulationSettings, run: int = 0) -> GroundMotion:
    ground = ground_of(settings, run)
    assert ground is not None
    return ground


def agree(
    values: NDArray[np.float64], rate_hz: float, length: int, low_hz: float, high_hz: float, wanted: Any
) -> None:
    """Welch's spectrum over the wanted one, averaged over a band, is one within the bounds of chance.

    Half-overlapping Hann windows are worth 9/11 independent ones in the mean over segments; a
    periodogram's bin has two degrees of freedom, and a Hann window makes two of three neighbours one.
    """
    frequencies_hz, found = scipy.signal.welch(values, rate_hz, nperseg=length)
    band = (frequencies_hz >= low_hz) & (frequencies_hz <= high_hz)
    ratio = float(np.mean(found[band] / wanted(frequencies_hz[band])))
    segments = 9 / 11 * (2 * len(values) / length - 1)
    freedom = 2 * segments * max(np.count_nonzero(band) / 1.5, 1)
    low, high = scipy.stats.chi2.ppf([5e-5, 1 - 5e-5], freedom) / freedom
    # what leaks from the neighbouring bins where a spectrum is steep
    assert low - 0.02 <= ratio <= high + 0.02, (low_hz, high_hz, ratio, low, high)


@pytest.mark.parametrize(
    "ground",
    [
        {"model": "white", "white_m_per_s2_per_sqrt_hz": 3e-6},
        {"model": "peterson", "between_noise_models": 0.5},
        {"model": "peterson", "above_low_noise_db": 24.0},
    ],
)
def test_spectrum_of_the_acceleration_is_that_of_the_model(ground: dict[str, Any]) -> None:
    truth = GroundTruth.model_validate(ground)
    found = moving(rig(ground=ground))
    times_s = np.arange(0, 4 * 3600 * 25) / 25.0
    both = [found.acceleration_m_per_s2[mode].at(times_s) for mode in (SLOW, FAST)]
    for values in both:
        for length, low_hz, high_hz in ((2**14, 0.01, 0.05), (2**12, 0.05, 0.5), (2**12, 0.5, 4.95)):
            agree(values, 25.0, length, low_hz, high_hz, lambda f: acceleration_density(truth, f) ** 2)
        # nothing beyond the band: a part of 1e-5 of what stands in it
        frequencies_hz, power = scipy.signal.welch(values, 25.0, nperseg=2**12)
        outside = power[frequencies_hz > 1.26 * truth.bandwidth_hz].sum()
        assert outside < 1e-4 * power[frequencies_hz < truth.bandwidth_hz].sum()
    # four standard deviations of a correlation coefficient; the peaks of a spectrum leave fewer numbers
    assert abs(np.corrcoef(both[0], both[1])[0, 1]) < 4 / math.sqrt(4 * 3600 * 0.1)


def test_level_half_way_is_the_mean_of_the_models_in_db() -> None:
    f = np.array([0.25])
    truth = GroundTruth(model="peterson", between_noise_models=0.5)
    level_db = 20 * np.log10(acceleration_density(truth, f))
    assert level_db == pytest.approx((nlnm_db(f) + nhnm_db(f)) / 2)
    # 1.0 um/s^2/sqrt(Hz): -119.4 dB
    assert acceleration_density(truth, f)[0] == pytest.approx(1.0e-6, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("by", "hours"), [("acceleration", 1.0), ("tilt", 1.0)])
def test_linear_oscillator_answers_with_its_transfer_function(by: str, hours: float) -> None:
    """Both modes without friction, with drag: the spectrum from 0.02 Hz to the band's end."""
    drags_s = 0.03, 0.01
    level = 1e-5
    ground: dict[str, Any] = {"model": "white", "white_m_per_s2_per_sqrt_hz": level}
    if by == "tilt":
        ground = {"tilt_rad_per_sqrt_hz": level * PER_ACCELERATION}
    settings = rig(
        contact={**NO_FRICTION, "drag_s": drags_s[0]},
        fast={"drag_s": drags_s[1], "amplitude_arcsec": 0.0},
        release={"way": "by command"},
        axes={"leakage": 0.0},
        ground=ground,
    )
    path = true_path(settings, hours * 3600.0, 20.0)
    for angles, w0, drag_s in ((path.y_rad, W0, drags_s[0]), (path.x_rad, 5 * W0, drags_s[1])):

        def answer(f: NDArray[np.float64], w0: float = w0, drag_s: float = drag_s) -> NDArray[np.float64]:
            w = 2 * np.pi * f
            transfer = w0**2 / np.abs(w0**2 - w**2 + 1j * w * drag_s * w0**2)
            return np.asarray((level * PER_ACCELERATION * transfer) ** 2)

        settled = angles[4000:]
        for low_hz, high_hz in ((0.02, 0.15), (0.2, 0.3), (0.35, 1.0), (1.05, 1.4), (1.5, 4.9)):
            agree(settled, 20.0, 2**12, low_hz, high_hz, answer)


def test_amplitude_and_phase_walk_in_steps_of_the_same_size() -> None:
    """Per half-cycle s = q sqrt(T_half)/(2 w0) in both quadratures, independent from step to step."""
    level = 1e-5
    settings = rig(
        contact=NO_FRICTION, ground={"model": "white", "white_m_per_s2_per_sqrt_hz": level, "seed": 3}
    )
    turns = true_turning_points(settings, max_duration_s=6000.0)
    q = W0**2 * PER_ACCELERATION * level
    s_rad = q * math.sqrt(PERIOD_S / 2) / (2 * W0)
    amplitudes = np.abs(turns.angle_rad)
    steps = np.diff(amplitudes) / s_rad
    phases = (np.diff(turns.time_s) - PERIOD_S / 2) * W0 * amplitudes[:-1] / s_rad
    bound = 4 / math.sqrt(len(steps))
    for found in (steps, phases):
        # the drive acts with sin^2 of the phase on one quadrature, so that steps of neighbours are not
        # exactly independent where the band ends; 4 sigma and 2 %
        assert found.std() == pytest.approx(1.0, abs=bound / math.sqrt(2) + 0.02)
        assert abs(found.mean()) < bound
        assert abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < bound
    assert abs(np.corrcoef(steps, phases)[0, 1]) < bound


def test_ground_of_no_size_changes_nothing() -> None:
    still = true_turning_points(rig())
    shaken = true_turning_points(rig(ground={"model": "white", "white_m_per_s2_per_sqrt_hz": 0.0}))
    assert shaken.angle_rad == pytest.approx(still.angle_rad, rel=1e-10)
    assert shaken.time_s == pytest.approx(still.time_s, rel=1e-10)
    assert ground_of(rig(), 0) is None
    lower = rig(ground={"model": "peterson", "mass_centre_height_m": 0.0})
    assert true_turning_points(lower).angle_rad == pytest.approx(still.angle_rad, rel=1e-10)


def test_same_ground_whoever_asks_and_in_which_steps() -> None:
    settings = rig(ground={"model": "peterson"})
    whole = true_path(settings, 1700.0, 16.0)
    assert BLOCK_KNOTS < 1700.0 * 20
    _, slow = motions(settings)
    times_s = np.arange(len(whole.y_rad)) / 16
    parts = [slow.sample(part)[0] for part in np.split(times_s, [1, 100, 101, 26000])]
    assert np.array_equal(np.concatenate(parts), whole.y_rad)
    coarse = true_path(settings, 1700.0, 1.0)
    assert np.array_equal(coarse.y_rad, whole.y_rad[::16])
    assert np.array_equal(coarse.x_rad, whole.x_rad[::16])
    turns = true_turning_points(settings)
    at_turns = motions(settings)[1].sample(turns.time_s)[0]
    assert at_turns == pytest.approx(turns.angle_rad, rel=1e-12)
    late, early = (moving(settings).drive_rad[SLOW].at(np.array([at])) for at in (1650.0, 3.0))
    both = moving(settings).drive_rad[SLOW].at(np.array([3.0, 1650.0]))
    assert (early[0], late[0]) == tuple(both)


def test_another_seed_or_run_is_other_ground() -> None:
    def first(run: int = 0, **changes: Any) -> float:
        ground = moving(rig(ground={"model": "white", "seed": changes.pop("ground_seed", 0)}, **changes), run)
        return float(ground.drive_rad[SLOW].at(np.array([1.0]))[0])

    values = [first(), first(run=1), first(seed=2), first(ground_seed=1)]
    assert len(set(values)) == 4
    assert first() == values[0]


def test_series_is_smooth_across_knots_and_blocks() -> None:
    series = moving(rig(ground={"model": "white"})).acceleration_m_per_s2[SLOW]
    scale = series.pieces(0.0).coefficients[:, 0].std()
    rows = series.pieces(0.0).coefficients
    assert np.abs(rows[:-1].sum(axis=1) - rows[1:, 0]).max() < 1e-12 * scale
    after = series.pieces(BLOCK_KNOTS / 20.0)
    assert after.start_s == BLOCK_KNOTS / 20.0
    assert rows[-1].sum() == pytest.approx(after.coefficients[0, 0], abs=1e-12 * scale)
    powers = np.arange(6)
    assert (rows[-1] * powers).sum() == pytest.approx(after.coefficients[0, 1], abs=1e-12 * scale)


def test_memory_stays_flat_over_hours() -> None:
    _, slow = motions(rig(ground={"model": "peterson"}))
    for hour in range(3):
        angles, _ = slow.sample(np.linspace(hour * 3600.0, hour * 3600.0 + 3599.0, 100))
        assert np.all(np.isfinite(angles))
    assert slow._ground is not None
    assert len(slow._ground._blocks) == 2
    assert not slow.at_rest


def test_friction_holds_the_resting_pendulum_until_the_ground_is_stronger() -> None:
    """Held while |drive| stays below c; above it moves, and stops again."""
    weak = rig(release={"way": "by command"}, ground={"model": "white", "white_m_per_s2_per_sqrt_hz": 1e-8})
    assert np.abs(moving(weak).drive_rad[SLOW].at(np.arange(0, 60, 0.02))).max() < weak.contact.c
    assert np.all(true_path(weak, 60.0, 10.0).y_rad == 0.0)
    strong = rig(release={"way": "by command"}, ground={"model": "white", "white_m_per_s2_per_sqrt_hz": 1e-5})
    times_s = np.arange(0, 60, 0.02)
    drive_rad = moving(strong).drive_rad[SLOW].at(times_s)
    breaks_away_s = times_s[np.flatnonzero(np.abs(drive_rad) > strong.contact.c)[0]]
    moved = np.flatnonzero(true_path(strong, 60.0, 50.0).y_rad)
    assert times_s[moved[0]] == pytest.approx(breaks_away_s, abs=0.05)


def write(path: Path, rows: list[str], header: str = "time_s,acceleration_m_per_s2") -> Path:
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def record_rows(count: int = 600, rate_hz: float = 2.0, scale: float = 1.0) -> list[str]:
    times_s = np.arange(count) / rate_hz
    return [f"{t},{scale * 1e-6 * math.sin(2 * math.pi * 0.25 * t)}" for t in times_s]


def with_line_52(line: str) -> list[str]:
    rows = record_rows()
    return [*rows[:50], line, *rows[51:]]


def from_file(path: Path, **changes: Any) -> SimulationSettings:
    return rig(ground={"model": "file", "file": str(path), **changes})


def value_at(series: SmoothSeries, time_s: float) -> float:
    return float(series.at(np.array([time_s]))[0])


def test_a_file_is_followed_as_recorded(tmp_path: Path) -> None:
    path = write(tmp_path / "ground.csv", record_rows())
    shifted = moving(from_file(path, file_offset_s=10.0))
    for settings, begin_s in ((moving(from_file(path)), 0.0), (shifted, 10.0)):
        for time_s in (20.0, 33.3, 100.77):
            wanted = 1e-6 * math.sin(2 * math.pi * 0.25 * (time_s + begin_s))
            assert value_at(settings.acceleration_m_per_s2[SLOW], time_s) == pytest.approx(wanted, abs=1e-8)
            assert value_at(settings.acceleration_m_per_s2[FAST], time_s) == 0.0
    assert shifted.acceleration_m_per_s2[SLOW].end_s == pytest.approx(289.5)


@pytest.mark.parametrize(("unit", "scale"), [("um", 1e6), ("nm", 1e9), ("mm", 1e3)])
def test_a_file_states_its_unit_and_may_have_two_components(tmp_path: Path, unit: str, scale: float) -> None:
    rows = [f"{row},{0.5 * float(row.split(',')[1])}" for row in record_rows(scale=scale, rate_hz=50.0)]
    path = write(tmp_path / "ground.csv", rows, f"time_s,north_{unit}_per_s2,east_{unit}_per_s2")
    found = moving(from_file(path)).acceleration_m_per_s2
    wanted = 1e-6 * math.sin(2 * math.pi * 0.25 * 5.3)
    # the mean of three periods of 12 s is taken off; it is zero
    assert value_at(found[SLOW], 5.3) == pytest.approx(wanted, abs=2e-8)
    assert value_at(found[FAST], 5.3) == pytest.approx(0.5 * wanted, abs=1e-8)


@pytest.mark.parametrize(
    ("rows", "header", "message"),
    [
        (record_rows()[:50] + record_rows()[60:], None, r"time_s goes from 24\.5 to 30"),
        (with_line_52("25.0,nan"), None, r"not all rows are 2 finite"),
        (with_line_52("25.0,"), None, r"cannot be read: .* row 50"),
        (with_line_52("25.0,1,2"), None, r"cannot be read: .* row 51"),
        (record_rows()[::-1], None, r"time_s goes from 299\.5 to 299,"),
        (record_rows(20), None, r"has 20 samples"),
        ([], None, r"has 0 samples"),
        (record_rows(), "time_s,velocity_m_per_s", r"velocity_m_per_s has no unit of acceleration"),
        (record_rows(), "time_s,acceleration", r"column acceleration has no unit"),
        (record_rows(), "seconds,acceleration_m_per_s2", r"its first line is"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_line(
    tmp_path: Path, rows: list[str], header: str | None, message: str
) -> None:
    path = write(tmp_path / "ground.csv", rows, header or "time_s,acceleration_m_per_s2")
    with pytest.raises(ConfigurationError, match=message) as caught:
        motions(from_file(path))
    assert "\n" not in str(caught.value)
    assert "simulation.ground.file" in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_file_that_is_missing_or_too_short_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no such file"):
        motions(from_file(tmp_path / "none.csv"))
    with pytest.raises(ValueError, match=r"needs ground\.file"):
        rig(ground={"model": "file"})
    path = write(tmp_path / "ground.csv", record_rows())
    long = from_file(path).model_copy(update={"max_duration_s": 400.0})
    with pytest.raises(ConfigurationError, match=r"lasts 299\.5 s, too short for 400 s of a run"):
        motions(long)
    with pytest.raises(ConfigurationError, match="too short for any run"):
        motions(from_file(path, file_offset_s=1000.0))
    # without a stated duration a run goes on as long as the file does
    assert len(true_path(from_file(path), 299.0, 10.0).y_rad) == 2991
    with pytest.raises(
        ConfigurationError, match=r"ends after 299\.5 s of a longer run.*use a longer file"
    ) as caught:
        true_path(from_file(path), 301.0, 10.0)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not SHARED.is_dir(), reason="data/ground is not there")
def test_a_real_record_drives_the_pendulum() -> None:
    settings = from_file(SHARED / "ulaanbaatar-lh1.csv", file_offset_s=300.0)
    recorded = np.loadtxt(SHARED / "ulaanbaatar-lh1.csv", delimiter=",", skiprows=1)[:, 1]
    series = moving(settings).acceleration_m_per_s2[SLOW]
    found = series.at(np.arange(0.0, 1000.0))
    assert found == pytest.approx(recorded[300:1300] - recorded.mean(), abs=0.02 * recorded[300:1300].std())
    still, shaken = true_turning_points(rig()), true_turning_points(settings)
    change_arcsec = np.abs(shaken.angle_rad[:500] - still.angle_rad[:500]) / ARCSEC_RAD
    assert 1e-3 < change_arcsec.max() < 1.0
