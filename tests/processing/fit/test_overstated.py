"""Uncertainties of spots that are stated too large hide the ground: that is said."""

from dataclasses import replace

import pytest

from processing.fit import fit_exact
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_decay


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_overstated_uncertainties_are_named(factor: float) -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = driven_decay(parameters, pendulum, q=1e-9, noise_arcsec=0.005, seed=4)
    stated = replace(points, u_time_s=factor * points.u_time_s, u_amplitude=factor * points.u_amplitude)
    fit = fit_exact(stated, pendulum, averaged=False)
    said = [warning for warning in fit.warnings if "times too large" in warning]
    assert bool(said) is (factor > 1)
    if said:
        assert "4 times too large" in said[0] or "3.9 times" in said[0] or "4.1 times" in said[0]
