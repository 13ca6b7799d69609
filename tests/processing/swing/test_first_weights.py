"""Uncertainties of the first half-cycles follow from the noise that is learned later."""

import numpy as np
import pytest

from processing.arrays import Floats
from processing.swing import HalfCycle, HalfCycleFlag, TurningPointDetector, with_learned_weights
from processing.units import ARCSEC_RAD
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path

PARAMETERS, PENDULUM = paper_pair("glass_k8", 1.7e-3)
NOISE_RAD = 0.003 * ARCSEC_RAD
SLOW_RAD = 0.02 * ARCSEC_RAD
FRAMES_PER_S = 50.0


def swings(slow: Floats | float, seed: int = 0) -> list[HalfCycle]:
    """Half-cycles of the first 330 s of a decay, seen in white noise and what is slow besides."""
    _, _, path = driven_path(PARAMETERS, PENDULUM, q=0.0, seed=1, frames_per_s=FRAMES_PER_S)
    path = path[: round(330 * FRAMES_PER_S)]
    seen = path + slow + NOISE_RAD * np.random.default_rng([seed, 21]).standard_normal(len(path))
    times_ns = np.arange(len(path), dtype=np.int64) * round(1e9 / FRAMES_PER_S)
    return TurningPointDetector().update(times_ns, seen, np.full(len(path), NOISE_RAD))


def slow_noise(seed: int) -> Floats:
    """Noise of 1/f as of air in the beam, from 0.02 to 5 Hz, with an r.m.s. of `SLOW_RAD`."""
    count = 1 << 15
    rng = np.random.default_rng([seed, 22])
    frequency_hz = np.fft.rfftfreq(count, 1 / FRAMES_PER_S)
    inside = (frequency_hz > 0.02) & (frequency_hz < 5.0)
    size = np.where(inside, frequency_hz, np.inf) ** -0.5
    out = np.fft.irfft(size * rng.standard_normal((2, len(size))).T.copy().view(np.complex128)[:, 0], count)
    return np.asarray(SLOW_RAD * out / out.std())[: round(330 * FRAMES_PER_S)]


def test_the_first_half_cycles_are_as_uncertain_as_the_noise_that_is_learned() -> None:
    clean = {swing.index: swing for swing in swings(0.0)}
    before, after = [], []
    for seed in range(2):
        found = swings(slow_noise(seed), seed)
        for raw, weighted in zip(found[1:9], with_learned_weights(found)[1:9], strict=True):
            off = weighted.amplitude - clean[weighted.index].amplitude
            before.append(off / raw.u_amplitude)
            after.append(off / weighted.u_amplitude)
    assert np.sqrt(np.mean(np.square(before))) > 2.0
    assert 0.5 < np.sqrt(np.mean(np.square(after))) < 1.4


def test_a_quiet_record_stays_as_it_is() -> None:
    found = swings(0.0)
    for raw, weighted in zip(found, with_learned_weights(found), strict=True):
        assert weighted.u_amplitude == pytest.approx(raw.u_amplitude, rel=0.03)
        assert weighted.u_turn_time_s == pytest.approx(raw.u_turn_time_s, rel=0.03)


def swing(index: int, u_amplitude: float, u_time_s: float, flags: int = 0) -> HalfCycle:
    """A half-cycle of a falling amplitude."""
    half_s = np.nan if index == 0 else 2.0
    of_turn = (2_000_000_000 * index, u_time_s, 100.0 / (1 + index), u_amplitude)
    return HalfCycle(index, *of_turn, half_s, u_time_s, 0.0, 1, flags)


def test_time_counts_by_the_arc_and_nothing_becomes_smaller_or_later() -> None:
    arc = 0.05
    found = [swing(k, 0.01 if k < 5 else 0.1, 1e-5 if k < 5 else arc * (1 + k) / 100.0) for k in range(100)]
    found[1] = swing(1, 0.01, 1e-5, int(HalfCycleFlag.VIBRATION))
    found[2] = swing(2, 7.0, 7.0)
    out = with_learned_weights(found)
    assert (out[1].u_amplitude, out[1].u_turn_time_s) == (0.01, 1e-5)
    assert (out[2].u_amplitude, out[2].u_turn_time_s) == (7.0, 7.0)
    for k in (0, 3, 4):
        assert out[k].u_amplitude == pytest.approx(0.1)
        assert out[k].u_turn_time_s * out[k].amplitude == pytest.approx(arc)
    assert out[4].u_half_period_s == pytest.approx(np.hypot(out[4].u_turn_time_s, out[3].u_turn_time_s))
    assert out[65:] == found[65:]
    assert [one.amplitude for one in out] == [one.amplitude for one in found]
    assert with_learned_weights(out) == out


def test_few_half_cycles_have_what_their_last_ones_know() -> None:
    found = [swing(k, 0.01 if k < 10 else 0.1, 1e-3) for k in range(40)]
    assert all(one.u_amplitude == 0.1 for one in with_learned_weights(found))
    assert with_learned_weights(found[:12]) == found[:12]
    assert with_learned_weights([]) == []
