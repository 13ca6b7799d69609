"""Uncertainties of the first half-cycles follow from the noise that is learned later."""

import numpy as np
import pytest

from processing.arrays import Floats
from processing.swing import HalfCycle, HalfCycleFlag, TurningPointDetector, with_learned_weights
from processing.units import ARCSEC_RAD
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path
from tests.processing.swing.truth import air, half_cycle

PARAMETERS, PENDULUM = paper_pair("glass_k8", 1.7e-3)
NOISE_RAD = 0.003 * ARCSEC_RAD
FRAMES_PER_S = 50.0
FRAMES = round(330 * FRAMES_PER_S)


def half_cycles(slow: Floats | float, seed: int = 0) -> list[HalfCycle]:
    """Half-cycles of the first 330 s of a decay, seen in white noise and what is slow besides."""
    _, _, path = driven_path(PARAMETERS, PENDULUM, q=0.0, seed=1, frames_per_s=FRAMES_PER_S)
    path = path[:FRAMES]
    seen = path + slow + NOISE_RAD * np.random.default_rng([seed, 21]).standard_normal(len(path))
    times_ns = np.arange(len(path), dtype=np.int64) * round(1e9 / FRAMES_PER_S)
    return TurningPointDetector().update(times_ns, seen, np.full(len(path), NOISE_RAD))


def test_the_first_half_cycles_are_as_uncertain_as_the_noise_that_is_learned() -> None:
    clean = {h.index: h for h in half_cycles(0.0)}
    before, after = [], []
    for seed in range(2):
        slow = air(FRAMES, FRAMES_PER_S, np.random.default_rng([seed, 22]))
        found = half_cycles(slow * ARCSEC_RAD, seed)
        for raw, weighted in zip(found[1:9], with_learned_weights(found)[1:9], strict=True):
            off = weighted.amplitude - clean[weighted.index].amplitude
            before.append(off / raw.u_amplitude)
            after.append(off / weighted.u_amplitude)
    assert np.sqrt(np.mean(np.square(before))) > 2.0
    assert 0.5 < np.sqrt(np.mean(np.square(after))) < 1.4


def test_a_quiet_record_stays_as_it_is() -> None:
    found = half_cycles(0.0)
    for raw, weighted in zip(found, with_learned_weights(found), strict=True):
        assert weighted.u_amplitude == pytest.approx(raw.u_amplitude, rel=0.03)
        assert weighted.u_turn_time_s == pytest.approx(raw.u_turn_time_s, rel=0.03)


def falling(index: int, u_amplitude: float, u_time_s: float, flags: int = 0) -> HalfCycle:
    """A half-cycle of a falling amplitude."""
    u = {"u_amplitude": u_amplitude, "u_turn_time_s": u_time_s, "u_half_period_s": u_time_s}
    return half_cycle(index, amplitude=100.0 / (1 + index), flags=flags, **u)


def test_time_counts_by_the_arc_and_nothing_becomes_smaller_or_later() -> None:
    arc = 0.05
    found = [falling(k, 0.01 if k < 5 else 0.1, 1e-5 if k < 5 else arc * (1 + k) / 100.0) for k in range(100)]
    found[1] = falling(1, 0.01, 1e-5, int(HalfCycleFlag.VIBRATION))
    found[2] = falling(2, 7.0, 7.0)
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
    found = [falling(k, 0.01 if k < 10 else 0.1, 1e-3) for k in range(40)]
    assert all(one.u_amplitude == 0.1 for one in with_learned_weights(found))
    assert with_learned_weights(found[:12]) == found[:12]
    assert with_learned_weights([]) == []
