"""A scale that is bent: its errors are small against the swing, and their slopes are not."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from processing.units import ARCSEC_RAD
from tests.processing.position_map.runs import run, searched

Floats = NDArray[np.float64]


def bent(time_s: Floats, place: Floats) -> Floats:
    """Of a position-sensitive diode whose scale is by 1 % another one at the end of the swing."""
    return np.asarray(0.01 * place * (place / (124.0 * ARCSEC_RAD)) ** 2)


def test_a_map_takes_its_errors_off_and_the_scale_it_leaves_open_is_as_uncertain_as_wrong() -> None:
    one = run(bent, seed=1)
    found = searched(one)
    assert found is not None
    true = np.linspace(*found.limits, 500)
    few = one.deflections[:500]
    measured = replace(few, y=true + found.error(true))
    assert np.max(np.abs(found.corrected(measured).y - true)) < 1e-5 * ARCSEC_RAD
    weight = true / (true @ true)
    matrix = found.splines.matrix(true)
    u_scale = float(np.sqrt(weight @ matrix @ found.covariance @ matrix.T @ weight))
    wrong = float(weight @ (found.error(true) - bent(true, true)))
    assert abs(wrong) < 2.5 * u_scale
