"""A start is judged by its first amplitude, in rad or in px."""

import math

import pytest

from calibration import deflection_unit
from calibration.light_lever import Lever
from processing.balance import Balance
from processing.deflections import DeflectionUnit
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD
from rig.measure.session_orders import StartJudge
from rig.settings import Configuration


def judge(lever: Lever | None) -> StartJudge:
    config = Configuration(camera={"driver": "simulated"})
    return StartJudge(config, deflection_unit(lever))


def swings(amplitude: float) -> list[HalfCycle]:
    return [
        HalfCycle(k, k * 10**9, 1e-5, amplitude, 1e-3 * amplitude, 1.0, 1e-5, 0.0, 1, 0) for k in range(2)
    ]


@pytest.mark.parametrize(("amplitude_arcsec", "accepted"), [(124.0, True), (10.0, False), (1000.0, False)])
def test_a_first_amplitude_in_arcsec_has_limits(amplitude_arcsec: float, accepted: bool) -> None:
    lever = Lever(arm_m=1.0, pixel_pitch_m=5e-6)
    rejection = judge(lever).rejection(swings(amplitude_arcsec * ARCSEC_RAD), [], 1.0)
    assert (rejection == "") is accepted
    if not accepted:
        assert f"first amplitude {amplitude_arcsec:.1f} arcsec" in rejection


@pytest.mark.parametrize("amplitude_px", [10.0, 1000.0])
def test_a_first_amplitude_in_px_has_none(amplitude_px: float) -> None:
    assert judge(None).rejection(swings(amplitude_px), [], 1.0) == ""


def balance(rotation_deg_per_min: float, u_deg_per_min: float = 0.01) -> Balance:
    per_min = math.pi / 180.0 / 60.0
    known = {
        "unit": DeflectionUnit.RAD,
        "amplitude": 124.0 * ARCSEC_RAD,
        "transverse_ratio": 0.001,
        "rotation_rad_per_s": rotation_deg_per_min * per_min,
        "u_rotation_rad_per_s": u_deg_per_min * per_min,
    }
    return Balance(**{**dict.fromkeys(Balance.__slots__, math.nan), **known})


@pytest.mark.parametrize(
    ("rate", "u", "rejected"),
    [(0.1, 0.01, False), (1.72, 0.01, True), (-1.72, 0.01, True), (0.3, 0.1, False)],
)
def test_a_plane_that_turns_is_no_start(rate: float, u: float, rejected: bool) -> None:
    """It is known some periods after the start was accepted otherwise, and judged once."""
    started = judge(Lever(arm_m=1.0, pixel_pitch_m=5e-6))
    unknown = balance(math.nan)
    assert started.rejection(swings(124.0 * ARCSEC_RAD), [unknown, unknown], 10.0) == ""
    why = started.rejection([], [unknown, balance(rate, u)], 20.0)
    assert bool(why) is rejected
    if rejected:
        assert f"{rate:+.2f} deg/min, at most 0.2 deg/min" in why
    assert started.rejection([], [balance(9.0)], 30.0) == ""
