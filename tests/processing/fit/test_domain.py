"""Laws fitted outside of their domain, and uncertainties that are stated too large, are named."""

from dataclasses import replace

import numpy as np
import pytest

from processing.estimate import Determinacy
from processing.fit import FitResult, domain_warnings, fit_exact, identifiability
from processing.swing import TurningPoints
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_decay

PARAMETERS, PENDULUM = paper_pair("glass_k8")
Fitted = tuple[TurningPoints, FitResult]


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    points = driven_decay(PARAMETERS, PENDULUM, q=0.0, noise_arcsec=0.005, seed=5)
    return points, fit_exact(points, PENDULUM, averaged=False)


def test_angles_beyond_the_contact_and_beyond_small_ones_are_named(fitted: Fitted) -> None:
    """The same decay as if it had been read in other units: 1.6 rad are 147 contact angles."""
    points, fit = fitted
    assert not list(domain_warnings(points, PENDULUM, fit))
    factor = 1.6 / points.amplitude[0]
    large = replace(points, amplitude=factor * points.amplitude, u_amplitude=factor * points.u_amplitude)
    said = list(domain_warnings(large, PENDULUM, fit))
    assert "1.60 rad, is 146 times the contact's angle" in said[0]
    assert "not a small angle" in said[1]
    between = replace(points, amplitude=0.012 / points.amplitude[0] * points.amplitude)
    assert len(list(domain_warnings(between, PENDULUM, fit))) == 1


def test_a_sign_that_cannot_be_is_named(fitted: Fitted) -> None:
    points, fit = fitted
    at = fit.names.index("gamma_pa")
    values = fit.values.copy()
    values[at] = -10 * fit.standard_uncertainty[at]
    (said,) = domain_warnings(points, PENDULUM, replace(fit, values=values))
    assert "gamma_pa" in said
    assert "negative by 10 u" in said
    assert "e+" not in said
    # what goes with it is not stated, and what does not is
    correlated = fit.correlation[at]
    found = {one.name: one for one in identifiability(points, PENDULUM, replace(fit, values=values))}
    assert found["b"].verdict is Determinacy.DETERMINED
    for name in fit.contact_names:
        if name != "gamma_pa" and abs(correlated[fit.names.index(name)]) > 0.2:
            assert found[name].verdict is Determinacy.UNDETERMINED
            assert np.isnan(found[name].lower_95)
            assert np.isnan(found[name].upper_95)
    # within its uncertainty a quantity that is zero may come out below
    values[at] = -2 * fit.standard_uncertainty[at]
    assert not list(domain_warnings(points, PENDULUM, replace(fit, values=values)))
    assert np.all(np.isfinite(values))


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_overstated_uncertainties_are_named(factor: float) -> None:
    points = driven_decay(PARAMETERS, PENDULUM, q=1e-9, noise_arcsec=0.005, seed=4)
    stated = replace(points, u_time_s=factor * points.u_time_s, u_amplitude=factor * points.u_amplitude)
    fit = fit_exact(stated, PENDULUM, averaged=False)
    said = [warning for warning in fit.warnings if "times too large" in warning]
    assert bool(said) is (factor > 1)
    if said:
        assert "4 times too large" in said[0] or "3.9 times" in said[0] or "4.1 times" in said[0]
