"""Clock relation, pointing stability, check at rest and axes, from synthetic samples."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy

from acquisition.simulation.settings import ContactTruth, FastModeTruth, ReleaseTruth
from calibration.axes_fit import AxesFit, fit_axes
from calibration.axes_window import require_rest
from calibration.pointing import stability
from calibration.timebase import relate_clocks, unwrap_counter
from processing.errors import DataError
from tests.calibration.simulated_rig import draw_rig, swing_for_axes

N = 2000


def stamps(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    true_s = np.arange(N) * 0.01
    device = np.rint(true_s * (1 + 40e-6) * 1e9).astype(np.int64)
    return device, np.rint((3 + true_s + 2e-5 * rng.standard_normal(N)) * 1e9).astype(np.int64)


def rms(z: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(z))))


@pytest.mark.parametrize("bits", [32, 48, 62, 63, 64])
def test_a_rolling_counter_is_unwrapped(bits: int) -> None:
    steps = np.arange(5000, dtype=np.uint64) * np.uint64(10_000_019)
    true = steps + np.uint64((1 << bits) - 12_345_678_901 % (1 << bits))  # 64 bits overflow by themselves
    unwrapped = unwrap_counter((true & np.uint64((1 << bits) - 1)).astype(np.int64), bits)
    np.testing.assert_array_equal(np.diff(unwrapped), np.diff(steps).astype(np.int64))


def test_a_jump_of_the_clock_is_found_where_it_is() -> None:
    device, host = stamps()
    host[1200:] += 3_000_000
    found = relate_clocks(device, host, np.arange(N))
    assert [jump.frame for jump in found.jumps] == [1200]
    assert found.jumps[0].step_s == pytest.approx(3e-3, abs=2e-5)
    assert abs(found.drift_ppm - 40) < 4 * found.u_drift_ppm


def test_frames_that_are_missing_are_no_jump_of_the_clock() -> None:
    """Over a gap the error of a rate by medians was called a jump, of 2 us, or hid one of 1 ms."""
    rng, sequence = np.random.default_rng(2), np.r_[0:500, 1500:3000]
    at_ns, errors, u_ppm = 10_000_000 * sequence, [], []
    for _ in range(6):
        host = at_ns + np.rint(3e4 * rng.standard_normal(len(at_ns))).astype(np.int64)
        found = relate_clocks(at_ns + sequence * 500, host, sequence)
        assert not found.jumps
        u_ppm.append(found.u_drift_ppm)
        errors.append((found.drift_ppm - 50) / found.u_drift_ppm)
        late = host + np.where(sequence >= 1500, 1_000_000, 0)
        (jump,) = relate_clocks(at_ns + sequence * 500, late, sequence).jumps
        assert jump.step_s == pytest.approx(1e-3, abs=2e-5)
        assert jump.frame == 1500
    assert rms(errors) < 1.8
    assert np.median(u_ppm) < 0.12, "0.22 with an offset on either side of the gap"


def test_times_far_from_zero_keep_their_nanoseconds() -> None:
    device, host = stamps()
    found = relate_clocks(device + 2**61, host + 2**60, np.arange(N))
    near = relate_clocks(device, host, np.arange(N))
    assert found.rate == near.rate
    again = found.host_ns(device + 2**61)
    assert np.abs(again - (host + 2**60)).max() < 2e5


@pytest.mark.slow
@pytest.mark.parametrize(("memory_s", "least"), [(0.0, 0.9), (0.5, 0.7)])
def test_the_rate_s_uncertainty_is_its_scatter_also_where_many_frames_in_a_row_are_late(
    memory_s: float, least: float
) -> None:
    z, kept = [], np.exp(-0.01 / memory_s) if memory_s else 0.0
    for seed in range(12):
        device, host = stamps(seed)
        late = 2e-5 * np.random.default_rng([seed, 1]).standard_normal(N)
        late = scipy.signal.lfilter([np.sqrt(1 - kept**2)], [1, -kept], late)
        found = relate_clocks(device, host + np.rint(1e9 * late).astype(np.int64), np.arange(N))
        z.append((found.drift_ppm - 40) / found.u_drift_ppm)
    # an rms of 12 deviations lies within 3/sqrt(24) of 1; what is sure is claimed somewhat too uncertain
    assert least - 3 / np.sqrt(24) < rms(z) < 1 + 3 / np.sqrt(24)


def test_where_the_host_s_clock_or_the_beam_wanders_rate_and_drift_scatter_as_claimed() -> None:
    """A random walk leaves little of itself about a line, and moves the line."""
    of_rate, of_drift = [], []
    for seed in range(12):
        walk = np.cumsum(np.random.default_rng([seed, 2]).standard_normal(N))
        device, host = stamps(seed)
        found = relate_clocks(device, host + np.rint(4e3 * walk).astype(np.int64), np.arange(N))
        of_rate.append((found.drift_ppm - 40) / found.u_drift_ppm)
        beam = stability(np.arange(N) * 0.01, 1e-3 * walk, np.ones(N))
        of_drift.append(beam.drift_per_s / beam.u_drift_per_s)
    assert 0.6 < rms(of_rate) < 1.6
    assert 0.6 < rms(of_drift) < 1.6


@pytest.mark.parametrize("which", ["camera", "host"])
def test_a_clock_that_runs_backwards_is_refused(which: str) -> None:
    device, host = stamps()
    (device if which == "camera" else host)[700] -= 20_000_000
    with pytest.raises(DataError, match=f"the {which}'s clock does not advance after frame 699"):
        relate_clocks(device, host, np.arange(N))


def test_a_counter_that_runs_backwards_is_refused() -> None:
    with pytest.raises(DataError, match="runs backwards after frame 1"):
        unwrap_counter(np.array([1000, 2000, 1500]), 32)


def test_lines_of_the_spectrum_are_named() -> None:
    rng = np.random.default_rng(4)
    times_s = np.arange(8000) / 250.0
    values = 0.02 * rng.standard_normal(8000)
    values += 0.03 * np.sin(2 * np.pi * 17.0 * times_s) + 0.02 * np.sin(2 * np.pi * 50.0 * times_s)
    found = stability(times_s, values, np.full(8000, 0.02))
    named = {round(line.frequency_hz): line for line in found.lines}
    assert named[17].name == "building"
    assert named[50].name.startswith("mains")
    # amplitude of a line in noise: u = sigma sqrt(2/N), and the window's scalloping below 3 %
    assert named[17].amplitude == pytest.approx(0.03, abs=4 * 0.02 * np.sqrt(3 / 8000) + 0.001)
    assert len(found.lines) == 2
    # a sinusoid adds A^2 sin^2(pi f tau) to the Allan variance of one sample
    there = np.hypot(0.02, np.hypot(0.03 * np.sin(np.pi * 17 / 250), 0.02 * np.sin(np.pi * 50 / 250)))
    assert found.claimed_ratio == pytest.approx(0.02 / there, rel=4 / np.sqrt(8000))


def test_lost_spots_shift_no_line() -> None:
    """Of 1 % lost, a line stood at a frequency 1 % too high, without its name; of 10 % it was gone."""
    rng = np.random.default_rng(4)
    times_s = np.arange(8000) / 250.0
    values = 0.02 * rng.standard_normal(8000) + 0.03 * np.sin(2 * np.pi * 50.0 * times_s)
    for lost in (0.01, 0.1):
        there = rng.random(8000) > lost
        (line,) = stability(times_s[there], values[there], np.full(there.sum(), 0.02)).lines
        assert line.name == "mains, 1 x 50 Hz"
        assert line.amplitude == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize(
    ("frequency_hz", "name"),
    [
        (60.0, "mains, 1 x 60 Hz"), (100.0, "mains, 2 x 50 Hz"), (119.9, "mains, 2 x 60 Hz"),
        (28.0, "building"), (40.0, ""), (61.0, ""),
    ],
)  # fmt: skip
def test_a_line_has_the_name_of_what_makes_it(frequency_hz: float, name: str) -> None:
    times_s = np.arange(10_000) / 500.0
    values = 0.01 * np.random.default_rng(4).standard_normal(10_000)
    values += 0.05 * np.sin(2 * np.pi * frequency_hz * times_s)
    found = stability(times_s, values, np.full(10_000, 0.01))
    assert [line.name for line in found.lines] == [name]


def test_white_noise_has_no_lines() -> None:
    rng = np.random.default_rng(5)
    found = stability(np.arange(20_000) * 0.01, rng.standard_normal(20_000), np.ones(20_000))
    assert found.lines == ()
    assert found.noise == pytest.approx(1.0, rel=4 / np.sqrt(4 / 3 * 20_000))
    assert found.iso11670 == pytest.approx(2.0, rel=4 / np.sqrt(40_000))


def test_a_pendulum_that_swings_where_it_should_rest_is_refused() -> None:
    rng = np.random.default_rng(6)
    times_s = np.arange(1000) * 0.02
    x, y = 0.02 * rng.standard_normal((2, 1000))
    require_rest(times_s, x, y, "record")
    with pytest.raises(DataError, match=r"swings by 0\.\d+ px in y with a period of 4"):
        require_rest(times_s, x, y + 0.4 * np.sin(2 * np.pi * times_s / 4.07), "record")


def test_handedness_and_sign_are_said_to_be_assumed() -> None:
    rig = draw_rig(3)
    told = swing_for_axes(rig, 30.0)
    assert told.handedness_known
    assert told.axes.mirrored == rig.settings.axes.mirrored
    assert told.notes == ()


def swinging(turning: Callable[[np.ndarray], np.ndarray]) -> AxesFit:
    rng = np.random.default_rng(8)
    t = np.arange(5000) * 0.02
    slow, fast = 100 * np.cos(2 * np.pi * t / 4.07), 10 * np.cos(2 * np.pi * t / 0.8)
    angle = turning(t)
    x, y = 0.02 * rng.standard_normal((2, 5000))
    return fit_axes(t, x + slow * np.sin(angle) + fast, y - slow * np.cos(angle))


def test_directions_that_scatter_beyond_their_noise_have_their_scatter_as_uncertainty() -> None:
    found = swinging(lambda t: 5e-5 * np.sign(np.sin(0.1 * t)))
    still = swinging(np.zeros_like)
    assert found.windows == 4
    assert found.chi2_per_dof > 5 > 2 > still.chi2_per_dof
    # four windows of directions that differ by some 5e-5 rad
    assert 1e-5 < found.axes.u_slow_angle_rad < 1e-4
    # chi-square of both modes is of six degrees of freedom, of which the fast one's three leave about three
    ratio = np.sqrt((6 * found.chi2_per_dof - 3) / 3)
    assert found.axes.u_slow_angle_rad == pytest.approx(ratio * still.axes.u_slow_angle_rad, rel=0.08)


@pytest.mark.parametrize(
    ("turning", "words"),
    [
        (lambda t: 2e-3 * t, r"direction is not the same in the 4 parts .* turns evenly, by 2 mrad/s"),
        (lambda t: 0.05 * (t > 40.0), r"the slow direction .* differs by 50 mrad, .* touched or shaken"),
    ],
)
def test_axes_that_do_not_stay_are_refused_with_the_cause(
    turning: Callable[[np.ndarray], np.ndarray], words: str
) -> None:
    with pytest.raises(DataError, match=words) as caught:
        swinging(turning)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fast_px", [150.0, 1500.0])
def test_a_fast_mode_that_is_pushed_harder_than_the_slow_one_is_still_the_fast_one(fast_px: float) -> None:
    """It was taken for the slow one, and the axes stood a right angle off, as known to 0.03 rad."""
    t, angle = np.arange(0, 60, 0.01), 0.1
    slow = 100.0 * np.exp(-t / 300) * np.cos(2 * np.pi * t / 4.07 + 0.3)
    fast = fast_px * np.exp(-t / 60) * np.cos(2 * np.pi * t / 0.807 + 0.7)
    noise = np.random.default_rng(1).normal(0, 0.02, (2, len(t)))
    x = slow * np.sin(angle) + fast * np.cos(angle) + noise[0]
    y = -slow * np.cos(angle) + fast * np.sin(angle) + noise[1]
    found = fit_axes(t, x, y, slow_began="+", fast_began="+")
    assert found.slow_period_s == pytest.approx(4.07, rel=1e-2)
    assert found.axes.u_slow_angle_rad < 2e-4
    assert abs(found.axes.slow_angle_rad - angle) < 4 * found.axes.u_slow_angle_rad
    assert not found.axes.mirrored


@pytest.mark.parametrize(("period_ratio", "fast_arcsec"), [(2.97, 3.0), (5.0, 0.3)])
def test_an_overtone_of_the_slow_mode_near_the_fast_mode_s_frequency_is_in_the_uncertainty(
    period_ratio: float, fast_arcsec: float
) -> None:
    z = []
    for seed in range(8):
        rig = draw_rig(seed)
        fast = FastModeTruth(
            amplitude_arcsec=fast_arcsec, period_ratio=period_ratio, phase_rad=(seed - 4) / 5
        )
        settings = rig.settings.model_copy(
            update={"fast": fast, "release": ReleaseTruth(), "contact": ContactTruth(drag_s=1.7e-3)}
        )
        axes = swing_for_axes(replace(rig, settings=settings, noise_px=0.003)).axes
        off_rad = axes.non_orthogonality_rad - settings.axes.non_orthogonality_rad
        assert axes.u_non_orthogonality_rad < 0.002
        z.append(off_rad / axes.u_non_orthogonality_rad)
    assert rms(z) < 1 + 4 / np.sqrt(2 * len(z))


def test_a_beam_that_wanders_is_in_the_uncertainty_of_the_slow_direction() -> None:
    """A random walk has more noise at the slow mode's frequency than elsewhere."""
    t, z = np.arange(1500) * 0.02, []
    slow, fast = 100 * np.cos(2 * np.pi * t / 4.07), 10 * np.cos(2 * np.pi * t / 0.8)
    for seed in range(12):
        steps = np.random.default_rng(seed).standard_normal((4, len(t)))
        x, y = 0.01 * steps[:2] + 0.005 * np.cumsum(steps[2:], axis=1)
        axes = fit_axes(t, x + fast, y - slow).axes
        z.append(axes.slow_angle_rad / axes.u_slow_angle_rad)
    assert rms(z) < 1 + 4 / np.sqrt(2 * len(z))


def test_axes_without_a_swing_or_a_fast_mode_are_refused() -> None:
    rng = np.random.default_rng(7)
    times_s = np.arange(1000) * 0.02
    x, y = 0.02 * rng.standard_normal((2, 1000))
    slow, near = 100 * np.cos(2 * np.pi * times_s / 4.07), 10 * np.cos(2 * np.pi * times_s / 1.9 + 0.8)
    for count, along, across, words in (
        (1000, 0.0 * slow, 0.0 * near, "does not swing"),
        (1000, slow, 0.0 * near, "no fast mode"),
        (1000, slow, near, "the fast mode is sought among periods below"),
        (300, slow, 0.0 * near, "slow periods"),
    ):
        with pytest.raises(DataError, match=words):
            fit_axes(times_s[:count], (x + across)[:count], (y + along)[:count])
