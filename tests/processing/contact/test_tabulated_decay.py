"""A walk through a table of half-swings ends where a law that a search tries describes no decay."""

import numpy as np
from scipy.interpolate import CubicSpline

from processing.contact.tabulated_decay import SwingTable, walk


def test_a_swing_that_a_law_makes_grow_ends_the_walk() -> None:
    log_a = np.log(np.geomspace(0.1, 1.0, 5))
    rows = np.tile([1.5, 0.5, 0.0, 0.0], (5, 1))  # each half-swing is half as large again
    table = SwingTable(0.1, CubicSpline(log_a, rows))
    found = walk(lambda _: table, 1, 1.0, np.arange(2000, dtype=np.int64))
    np.testing.assert_allclose(found.amplitude[:3], [1.0, 1.5, 2.25])
    assert np.isnan(found.amplitude[3:]).all()
    assert np.isnan(found.time[3:]).all()
