"""What is said of the ground: its drive, the base's acceleration, and what it costs."""

import numpy as np
import pytest

from acquisition.simulation.settings import GroundTruth
from processing.estimate import Estimate
from processing.fit import fit_exact
from rig.analysis.contact_verdicts import base_motion, fit_results
from rig.analysis.run_remarks import ground_sentence
from rig.settings import PendulumSettings
from tests.processing.fit.decays import decay, paper_pair
from tests.processing.fit.driven import driven_decay

RIG = PendulumSettings(mass_kg=0.406, ball_radius_m=6.05e-3, mass_centre_height_m=-2e-4)


def test_the_base_of_a_known_drive() -> None:
    """A basement half way between the noise models drives a pendulum balanced to 0.2 mm with 8e-9."""
    truth = GroundTruth(model="peterson", between_noise_models=0.5, mass_centre_height_m=-2e-4)
    assert truth.mass_centre_height_m == RIG.mass_centre_height_m
    moved = base_motion(Estimate(8.04e-9, 8e-10), 1e-8, 4.071, RIG)
    assert moved is not None
    value, u = moved.acceleration_m_per_s2_rthz
    assert value == pytest.approx(1.0e-6, rel=0.02)
    assert u == pytest.approx(0.1 * value, rel=0.01)
    # half way: 22 dB over the low model, whose level at 4 s is -141 dB
    assert moved.above_low_noise_model_db == pytest.approx(22.0, abs=1.0)
    assert (
        base_motion(Estimate(8e-9, 8e-10), 1e-8, 4.071, RIG.model_copy(update={"mass_centre_height_m": None}))
        is None
    )


def test_a_driven_run_says_what_drives_it_and_what_that_costs() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = driven_decay(parameters, pendulum, q=1e-8, noise_arcsec=0.005, seed=2, last_arcsec=10)
    found = fit_results(fit_exact(points, pendulum, averaged=False), RIG).ground
    assert found is not None
    assert found.seen
    assert min(found.widening.values()) > 3
    text = ground_sentence(found)
    assert "rad/s²/√Hz" in text
    assert "nm/s²/√Hz of acceleration for a mass centre −0.200 mm high, NLNM +24 dB" in text
    assert "Finer balancing, a quieter hour, a larger first amplitude or more runs would help." in text


def test_a_run_at_rest_sets_a_bound_and_asks_for_nothing() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=1, last_arcsec=10)
    found = fit_results(fit_exact(points, pendulum), RIG).ground
    assert found is not None
    assert not found.seen
    assert np.isfinite(found.upper_95)
    text = ground_sentence(found)
    assert text.count("below") == 2
    assert text.count("(95 %)") == 2
    assert "dB" not in text
    assert "help" not in text
