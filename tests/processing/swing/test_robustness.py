"""Half-cycles with gaps, lost spots, bursts, kicks, releases or drifts are flagged or missing, not wrong."""

import math
from itertools import pairwise

import numpy as np
import pytest

from processing.errors import DataError
from processing.swing import HalfCycle, HalfCycleFlag, TurningPointDetector, half_cycles_of
from tests.processing.swing.truth import Record, contact_decay, damped_sinusoid, detect, errors, rms


def decay(seed: int = 1) -> Record:
    return damped_sinusoid(np.random.default_rng(seed), 300.0, 60.0, 60)


def assert_none_wrong(record: Record, half_cycles: list[HalfCycle], fewest: int, limit: float = 5.0) -> None:
    e = errors(record, half_cycles)
    assert len(e) >= fewest
    assert np.abs(e.amplitude).max() < limit
    assert np.abs(e.time).max() < limit
    assert [s.index for s in half_cycles] == sorted({s.index for s in half_cycles})


def indices_match(record: Record, half_cycles: list[HalfCycle]) -> bool:
    """Whether differences of indices are numbers of half periods."""
    nearest = [int(np.argmin(np.abs(record.turn_time_s - s.turn_time_ns * 1e-9))) for s in half_cycles]
    return len({s.index - k for s, k in zip(half_cycles, nearest, strict=True)}) == 1


def test_swing_says_what_happened() -> None:
    record = decay()
    half_cycles = [s for s in detect(record) if not s.flags]
    for half_cycle in half_cycles:
        k = int(np.argmin(np.abs(record.turn_time_s - half_cycle.turn_time_ns * 1e-9)))
        assert half_cycle.side == (-1) ** k
        assert half_cycle.centre == pytest.approx(12.3, abs=0.05)
    half_periods = np.array([s.half_period_s for s in half_cycles[1:]])
    assert half_periods == pytest.approx(2.0, abs=5e-4)
    assert np.mean([s.u_half_period_s for s in half_cycles[1:]]) == pytest.approx(
        half_periods.std(), rel=4 / math.sqrt(2 * len(half_periods))
    )


@pytest.mark.parametrize(
    ("start_s", "length_s", "lost"),
    [(50.0, 0.6, False), (50.3, 1.1, True), (40.0, 7.0, False), (40.0, 7.0, True), (40.0, 50.0, True)],
)
def test_gap(start_s: float, length_s: float, lost: bool) -> None:
    record = decay()
    gap = (record.time_s > start_s) & (record.time_s < start_s + length_s)
    gapped = record.plus(np.where(gap, np.nan, 0.0)) if lost else record.keep(~gap)
    half_cycles = detect(gapped)
    assert_none_wrong(gapped, half_cycles, fewest=60 - math.ceil(length_s / 2.0) - 4)
    assert indices_match(record, half_cycles)
    inside = [s for s in half_cycles if start_s < s.turn_time_ns * 1e-9 < start_s + length_s]
    assert all(s.flags & HalfCycleFlag.GAP for s in inside)
    for before, after in pairwise(half_cycles):
        # the half period is unknown after a half-cycle that is missing
        is_missing = after.index > before.index + 1
        assert math.isnan(after.half_period_s) == math.isnan(after.u_half_period_s) == is_missing


@pytest.mark.parametrize(
    ("size_px", "length_s", "frequency_hz"),
    [
        (5.0, 0.3, 7.3), (1.0, 0.2, 23.0), (0.2, 0.5, 7.3), (0.06, 2.5, 7.3), (0.06, 2.5, 23.0),
        (30.0, 6.0, 23.0), (300.0, 9.0, 7.3),
    ],
)  # fmt: skip
def test_burst_of_vibration(size_px: float, length_s: float, frequency_hz: float) -> None:
    record = decay()
    since = record.time_s - 60.3
    burst = np.where(
        (since > 0) & (since < length_s),
        size_px * np.exp(-since / length_s) * np.sin(2 * np.pi * frequency_hz * since + 1.0),
        0.0,
    )
    disturbed = record.plus(burst)
    half_cycles = detect(disturbed)
    assert_none_wrong(disturbed, half_cycles, fewest=60 - math.ceil(length_s / 2.0) - 5)
    assert indices_match(record, half_cycles)
    hit = [
        s for s in half_cycles if s.turn_time_ns * 1e-9 + 1.0 > 60.3 and s.turn_time_ns * 1e-9 - 1.0 < 60.8
    ]
    assert any(s.flags & (HalfCycleFlag.VIBRATION | HalfCycleFlag.START) for s in hit)


def test_wild_samples_cost_nothing() -> None:
    record = decay()
    rng = np.random.default_rng(3)
    wild = np.zeros(len(record.times_ns))
    wild[rng.integers(0, len(wild), 60)] = rng.normal(0.0, 200.0, 60)
    spoiled = record.plus(wild)
    half_cycles = detect(spoiled)
    assert_none_wrong(spoiled, half_cycles, fewest=55)
    e = errors(spoiled, half_cycles)
    assert rms(e.amplitude) < 1.1 + 4 / math.sqrt(2 * len(e))


def test_release_from_a_hold_in_the_middle_of_a_record() -> None:
    record = contact_decay("glass_k8", 40, noise=0.02, rng=np.random.default_rng(5), start_s=20.0, hold=True)
    half_cycles = detect(record)
    first = [s for s in half_cycles if s.turn_time_ns * 1e-9 < 20.5]
    assert all(s.flags & HalfCycleFlag.START for s in first)
    assert_none_wrong(record, half_cycles, fewest=37)


RATE_RAD_PER_S, DAMPING_PER_S = 1.55, 0.004
LAG = math.atan(DAMPING_PER_S / RATE_RAD_PER_S)


def decay_from(t: np.ndarray, phase: float = 0.0) -> np.ndarray:
    return 200.0 * np.exp(-DAMPING_PER_S * t) * np.cos(RATE_RAD_PER_S * t + phase)


def noisy(
    t: np.ndarray, deflection: np.ndarray, turns_s: np.ndarray, amplitudes: np.ndarray, seed: int
) -> Record:
    noise = 0.02 * np.random.default_rng(seed).standard_normal(len(t))
    return Record(
        np.rint(1e9 * t).astype(np.int64), deflection + noise, np.full(len(t), 0.02), turns_s, amplitudes
    )


def test_kick_out_of_rest() -> None:
    t, start = np.arange(0, 120, 0.01), 20.0
    turns = (np.arange(60) * math.pi + math.pi / 2.0 - LAG) / RATE_RAD_PER_S
    deflection = 5.0 + np.where(t < start, 0.0, decay_from(t - start, -0.5 * math.pi))
    amplitudes = 200.0 * np.exp(-DAMPING_PER_S * turns) * math.cos(LAG)
    record = noisy(t, deflection, start + turns, amplitudes, 6)
    half_cycles = detect(record)
    assert all(s.flags for s in half_cycles if s.turn_time_ns * 1e-9 < start)
    assert_none_wrong(record, [s for s in half_cycles if s.turn_time_ns * 1e-9 > start], fewest=47)


@pytest.mark.parametrize(("phase", "rest_s"), [(0.0, 3.0), (0.5, 2.6), (1.5, 2.1), (6.0, 3.3)])
def test_a_faint_swing_before_a_push_is_not_the_first_half_cycle(phase: float, rest_s: float) -> None:
    """At rest it still swings by 0.03 arcsec, ten times its noise: smooth, and no part of the decay."""
    time_s = np.arange(0, 40, 0.01)
    since_s = time_s - rest_s
    pushed = 124.0 * np.exp(-0.005 * since_s) * np.sin(0.5 * math.pi * since_s)
    noise = 0.0026 * np.random.default_rng(1).standard_normal(len(time_s))
    y = np.where(since_s < 0, 0.0, pushed) + 0.03 * np.cos(0.5 * math.pi * time_s + phase) + noise
    half_cycles = half_cycles_of(np.round(1e9 * time_s).astype(np.int64), y, np.full(len(y), 0.0026))
    assert min(h.amplitude for h in half_cycles if not h.flags) > 90
    assert half_cycles[0].flags & HalfCycleFlag.START


@pytest.mark.parametrize(("factor", "phase"), [(2.0, 0.3), (0.5, 2.0), (0.4, 0.1), (1.0, 0.02)])
def test_kick_in_the_middle(factor: float, phase: float) -> None:
    t, kick = np.arange(0, 200, 0.01), 100.4
    first = (np.arange(100) * math.pi - LAG) / RATE_RAD_PER_S
    second = first - phase / RATE_RAD_PER_S
    first, second = first[first < kick], second[second > kick]
    turns, size = np.concatenate([first, second]), np.repeat([1.0, factor], [len(first), len(second)])
    deflection = np.where(t < kick, decay_from(t), factor * decay_from(t, phase))
    amplitudes = 200.0 * math.cos(LAG) * np.exp(-DAMPING_PER_S * turns) * size
    record = noisy(t, deflection, turns, amplitudes, 7)
    half_cycles = detect(record)
    disturbed = [abs(s.turn_time_ns * 1e-9 - kick) < 0.5 * math.pi / RATE_RAD_PER_S for s in half_cycles]
    assert all(s.flags for s, near in zip(half_cycles, disturbed, strict=True) if near)
    assert_none_wrong(
        record, [s for s, near in zip(half_cycles, disturbed, strict=True) if not near], fewest=88
    )
    assert any(s.flags & (HalfCycleFlag.START | HalfCycleFlag.VIBRATION) for s in half_cycles if s.index > 3)


@pytest.mark.parametrize(
    ("size_px", "period_s", "limit"), [(3.0, 600.0, 6.0), (0.5, 60.0, 15.0), (1.0, 120.0, 15.0)]
)
def test_rest_position_that_swings_slowly(size_px: float, period_s: float, limit: float) -> None:
    """Drafts: the uncertainties must grow with what the centre does; at first nobody can know."""
    record = damped_sinusoid(np.random.default_rng(8), 300.0, 30.0, 150)
    drafty = record.plus(size_px * np.sin(2 * np.pi * record.time_s / period_s))
    e = errors(drafty, detect(drafty))
    assert len(e) > 135
    assert np.abs(e.amplitude).max() < limit
    learned = e.index > 20
    assert rms(e.amplitude[learned]) < 1.6
    assert rms(e.time[learned]) < 2.2


def test_noise_that_was_told_too_small_is_noticed() -> None:
    record = decay()
    noisy = record.plus(0.06 * np.random.default_rng(9).standard_normal(len(record.times_ns)))
    e = errors(noisy, detect(noisy))
    assert len(e) >= 57
    assert rms(e.amplitude) < 1.1 + 4 / math.sqrt(2 * len(e))


def test_faint_swings_are_flagged() -> None:
    record = damped_sinusoid(np.random.default_rng(10), 1.0, 0.004, 160, noise=0.02)
    half_cycles = detect(record)
    faint = [s for s in half_cycles if s.amplitude < 4.0 * s.u_amplitude]
    assert len(faint) > 3
    assert all(s.flags & HalfCycleFlag.LOW_AMPLITUDE for s in faint)


@pytest.mark.parametrize("kind", ["rest", "noise", "lost", "nothing", "empty"])
def test_no_oscillation_no_swings(kind: str) -> None:
    rng = np.random.default_rng(11)
    times_ns = np.arange(0, 0 if kind == "empty" else 100_000_000_000, 10_000_000)
    n = len(times_ns)
    deflection = {
        "rest": 0.02 * rng.standard_normal(n),
        "noise": 0.02 * rng.standard_normal(n) + 0.3 * np.sin(np.arange(n) * 1e-4),
        "lost": np.full(n, np.nan),
        "nothing": np.zeros(n),
        "empty": np.zeros(n),
    }[kind]
    detector = TurningPointDetector()
    assert detector.update(times_ns, deflection, np.full(n, 0.02)) == []
    assert detector.finish() == []


@pytest.mark.parametrize(
    ("times", "values", "u", "words"),
    [
        ([3, 2], [0.0, 0.0], [1.0, 1.0], "run backwards at sample 1 of the block: 2 ns after 3 ns"),
        ([0, 1], [0.0, 0.0], [1.0, 1.0], "0 ns after 1 ns"),
        ([3, 4], [0.0], [1.0, 1.0], "of one length"),
        ([3, 4], [0.0, 0.0], [1.0], "of one length"),
        ([3, 4], [0.0, 0.0], [1.0, 0.0], "uncertainty of sample 1 of the block is 0.0"),
        ([3, 4], [0.0, 0.0], [-1.0, 1.0], "positive and finite"),
        ([3, 4], [0.0, 0.0], [math.nan, 1.0], "positive and finite"),
    ],
)
def test_bad_input_is_refused_and_changes_nothing(
    times: list[int], values: list[float], u: list[float], words: str
) -> None:
    detector = TurningPointDetector()
    detector.update([0, 1], [0.0, 0.0], [1.0, 1.0])
    with pytest.raises(DataError, match=words) as caught:
        detector.update(times, values, u)
    assert "\n" not in str(caught.value)
    assert detector.update([1, 1, 2], [0.0, math.nan, 0.0], [1.0, math.nan, 1.0]) == []
