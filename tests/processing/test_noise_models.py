"""Peterson's noise models: published values, and pieces that meet."""

import numpy as np
import pytest

from processing.noise_models import _NHNM, _NLNM, density_of_db, nhnm_db, nlnm_db


@pytest.mark.parametrize(("model", "table"), [(nlnm_db, _NLNM), (nhnm_db, _NHNM)])
def test_the_pieces_meet(model: object, table: np.ndarray) -> None:
    assert callable(model)
    for period_s in table[1:, 0]:
        before, after = model(np.array([1 / (period_s * (1 - 1e-9)), 1 / (period_s * (1 + 1e-9))]))
        assert before == pytest.approx(after, abs=0.3), period_s


def test_levels_are_the_published_ones() -> None:
    """Peterson 1993, tables 3 and 4: dB relative to 1 (m/s^2)^2/Hz at the ends of their pieces."""
    low = nlnm_db(1 / np.array([0.1, 1.24, 5.0, 31.6, 101.0, 1e5]))
    assert low == pytest.approx([-168.0, -163.7, -141.1, -185.0, -185.0, -103.1], abs=0.2)
    high = nhnm_db(1 / np.array([0.1, 0.22, 4.6, 20.0, 354.8, 1e5]))
    assert high == pytest.approx([-91.5, -97.4, -96.5, -138.5, -126.0, -48.5], abs=0.2)
    within = 1 / np.array([0.1, 4.3, 5.0, 1000.0])
    assert nlnm_db(within) == pytest.approx([-168.0, -141.1, -141.1, -178.5], abs=0.03)
    assert nhnm_db(within) == pytest.approx([-91.5, -97.03, -97.69, -111.77], abs=0.03)


def test_beyond_the_ends_the_last_value_holds() -> None:
    for model in (nlnm_db, nhnm_db):
        beyond = model(np.array([50.0, 10.0, 1e-5, 1e-7]))
        assert beyond[0] == beyond[1]
        assert beyond[2] == beyond[3]


def test_a_level_is_a_density() -> None:
    assert density_of_db(np.array([-120.0, 0.0])) == pytest.approx([1e-6, 1.0])
