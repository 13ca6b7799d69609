"""The pendulum's configuration behind the advice: effects of the weights, and height of the mass centre."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from processing.balance import Balance
from processing.units import ARCSEC_RAD
from rig.instrument.balance import elastic_drop, mass_centre_height, nominal_effects
from rig.settings import Configuration
from tests.rig.made_up import balance_of

PENDULUM = {"mass_kg": 2.0, "ball_radius_m": 0.008, "contact_radius_m": 40e-6, "gravity_m_per_s2": 9.8}
WEIGHT = {"mass_kg": 0.03, "pitch_m": 0.4e-3}


def configured(balance: Mapping[str, Any]) -> Configuration:
    """A pendulum with this section [balance]."""
    stated = {"camera": {"driver": "simulated"}, "pendulum": PENDULUM, "balance": balance}
    return Configuration.model_validate(stated)


def test_a_turn_moves_the_mass_centre_by_the_weights_share_of_the_mass() -> None:
    weights = {
        "weight_x": {**WEIGHT, "sense": -1},
        "weight_y": {**WEIGHT, "mass_kg": 0.01},
        "weight_height": {**WEIGHT, "pitch_m": 0.7e-3},
        "u_effect": 0.4,
    }
    effects = nominal_effects(configured(weights))
    assert None not in effects.values()
    values, us = ({name: effect[k] for name, effect in effects.items() if effect} for k in (0, 1))
    # 0.03 kg of 2 kg moved by 0.4 mm shift the mass centre by 6 um, which tilts a ball of 8 mm by 0.75 mrad
    assert values["x"] == pytest.approx([-0.75e-3 / ARCSEC_RAD, 0.0, 0.0])
    assert values["y"] == pytest.approx([0.0, 0.25e-3 / ARCSEC_RAD, 0.0])
    assert values["height"] == pytest.approx([0.0, 0.0, -10.5e-6])
    # along its own axis 40 %, across 0.3 of that; a screw may be askew
    assert us["x"] == pytest.approx([0.3e-3 / ARCSEC_RAD, 0.3e-3 / ARCSEC_RAD, 0.4 * 0.3 * 6e-6])
    tilt_by_height = 0.4 * 0.3 * (10.5e-6 / 0.008) / ARCSEC_RAD
    assert us["height"] == pytest.approx([tilt_by_height, tilt_by_height, 0.4 * 10.5e-6])


@pytest.mark.parametrize("unknown", [{"mass_kg": 0.0}, {"sense": 0}])
def test_a_weight_of_unknown_mass_or_sense_has_no_effect(unknown: dict[str, float]) -> None:
    effects = nominal_effects(configured({"weight_y": {**WEIGHT, **unknown}}))
    assert effects["y"] is None
    assert effects["x"] is not None


def test_the_height_of_the_mass_centre_follows_from_the_period_without_elasticity() -> None:
    def balance(period_s: float) -> Balance:
        return balance_of(period_s=period_s, u_period_s=1e-3, amplitude=1e-4)

    # a mass centre 7.99 mm below the ball's centre is 10 um above the contact; gravity's period is 4 s
    inertia_kg_m2 = 2.0 * 9.8 * 7.99e-3 * (4.0 / (2.0 * math.pi)) ** 2
    gravity = {"inertia_kg_m2": inertia_kg_m2}
    height_m, u_m = mass_centre_height(configured(gravity), balance(4.0))
    assert height_m == pytest.approx(10e-6, abs=1e-9)
    assert u_m == pytest.approx(2.0 * 8e-3 * 1e-3 / 4.0)
    elastic = configured({**gravity, "gamma_pa": 2e8, "n": 0.2})
    drop = elastic_drop(elastic, 1e-4)
    assert 1e-4 < drop < 0.1
    # the contact's elasticity makes the period longer than gravity alone does
    raised_m, _ = mass_centre_height(elastic, balance(4.0 / math.sqrt(1.0 - 2.0 * drop)))
    assert raised_m == pytest.approx(height_m, abs=1e-9)
    assert np.isnan(mass_centre_height(configured({}), balance(4.0))).all()
