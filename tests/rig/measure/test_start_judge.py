"""A start is judged by its first amplitude, in rad or in px."""

import pytest

from calibration.axes import Axes
from calibration.light_lever import Lever
from processing.angle import ARCSEC_RAD
from processing.spot import SensorModel
from processing.swing import Swing
from rig.instrument import Optics
from rig.measure.start_judge import StartJudge, start_limits
from rig.settings import Configuration


def judge(lever: Lever | None) -> StartJudge:
    return StartJudge(
        start_limits(
            Configuration(camera={"driver": "simulated"}), Optics(SensorModel(1.0, 5.0, 255.0), lever, Axes())
        )
    )


def swings(amplitude: float) -> list[Swing]:
    return [Swing(k, k * 10**9, 1e-5, amplitude, 1e-3 * amplitude, 1.0, 1e-5, 0.0, 1, 0) for k in range(2)]


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
