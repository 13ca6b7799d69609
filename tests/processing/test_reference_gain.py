"""The gain of a reference spot from a run that swings, on synthetic motion of other kinds than its model."""

import numpy as np
import pytest

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.estimate import Estimate
from processing.reference_gain import gain_while_swinging

FRAMES_PER_S, U_PX, GAIN = 50.0, 0.01, 1.5


def seen(
    seed: int, duration_s: float = 60.0, swing_px: float = 60.0, related: bool = True, common: float = 1.0
) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Times, the pendulum's spot and the reference's with their noise: a decay, air, a walk."""
    rng, count = np.random.default_rng(seed), round(duration_s * FRAMES_PER_S)
    time_s = np.arange(count) / FRAMES_PER_S
    frequency = np.maximum(np.fft.rfftfreq(count, 1 / FRAMES_PER_S), 0.05)

    def air() -> Floats:
        made = np.fft.irfft(np.fft.rfft(rng.standard_normal(count)) * frequency ** (-5 / 6), count)
        walk = 2e-4 * np.cumsum(rng.standard_normal(count))
        return np.asarray(common * (0.05 * made / np.std(made) + walk))

    beam = air()
    swing = swing_px * np.exp(-time_s / 400) * np.cos(2 * np.pi * 0.24 * time_s * (1 + 1e-5 * time_s))
    swing += 1e-3 * swing_px * np.exp(-time_s / 400) * np.cos(2 * np.pi * 0.72 * time_s)
    spot = swing + GAIN * (beam if related else air()) + U_PX * rng.standard_normal(count)
    reference = beam + U_PX * rng.standard_normal(count)
    u = np.full(count, U_PX)
    return np.rint(1e9 * time_s).astype(np.int64), spot, u, reference, u


def spread(found: list[Estimate], true: float) -> Floats:
    return np.array([(one.value - true) / one.standard_uncertainty for one in found])


@pytest.mark.parametrize(("duration_s", "u"), [(60.0, 0.1), (300.0, 0.03)])
def test_the_gain_is_found_beside_a_swing_a_thousand_times_as_large(duration_s: float, u: float) -> None:
    found = [gain_while_swinging(*seen(seed, duration_s)) for seed in range(40)]
    off = spread(found, GAIN)
    assert max(one.standard_uncertainty for one in found) < u
    assert 0.6 < float(np.std(off)) < 1.4
    assert abs(float(np.mean(off))) < 3.5 / np.sqrt(len(found))


def test_an_unrelated_reference_has_none() -> None:
    off = spread([gain_while_swinging(*seen(seed, related=False)) for seed in range(40)], 0.0)
    # of ten parts, as Student has it
    assert np.count_nonzero(np.abs(off) > 4.0) <= 1
    assert np.max(np.abs(off)) < 6.0


def test_lost_frames_and_a_long_gap_do_not_pull_it() -> None:
    rows = seen(3, 300.0)
    rng = np.random.default_rng(4)
    lost = rng.random(len(rows[0])) < 0.03
    lost[4000:6500] = True
    rows[3][lost] = np.nan
    found = gain_while_swinging(*rows)
    assert found.value == pytest.approx(GAIN, abs=4 * found.standard_uncertainty)
    assert found.standard_uncertainty < 0.03


def test_what_shows_no_gain_is_said() -> None:
    with pytest.raises(DataError, match="640 are needed for the gain"):
        gain_while_swinging(*(one[:600] for one in seen(0)))
    rows = seen(0, 300.0)
    rows[3][:] = np.nan
    with pytest.raises(DataError, match="0 frames have both spots"):
        gain_while_swinging(*rows)
    rows = seen(1, 60.0)
    rows[3][np.arange(len(rows[3])) % 600 < 300] = np.nan
    with pytest.raises(DataError, match="too few stretches"):
        gain_while_swinging(*rows)
