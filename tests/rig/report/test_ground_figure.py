"""The picture of what the ground could do: the numbers in it, and what stands there without a height."""

import numpy as np
import pytest

from processing.estimate import Estimate
from processing.fit import BaseMotion, Ground
from processing.noise_models import density_of_db, nlnm_db
from processing.swing import ResidualSpectrum
from processing.units import ARCSEC_RAD
from rig.report.figures_motion import spectrum_figure

PENDULUM_HZ, PER_DRIVE = 0.25, 60.0
FREQUENCY_HZ = np.arange(0.6, 12.5, 0.0125)


def drawn(ground: Ground | None):
    density = np.full(len(FREQUENCY_HZ), (0.002 * ARCSEC_RAD) ** 2)
    spectrum = ResidualSpectrum(FREQUENCY_HZ, density, 0.1, PENDULUM_HZ)
    return spectrum_figure(spectrum, "arcsec", ARCSEC_RAD, ground).figure.axes


def ground(seen: bool) -> Ground:
    base = BaseMotion(
        mass_centre_height_m=2e-4, acceleration_m_per_s2_rthz=Estimate(6e-7, 6e-8), upper_95=7.2e-7
    )
    return Ground(
        density_rad_per_s2_rthz=Estimate(1e-8, 1e-9), upper_95=7.2e-7 / PER_DRIVE, seen=seen, base=base
    )


def test_without_a_height_there_is_the_deflection_alone() -> None:
    (deflection,) = drawn(None)
    assert deflection.lines[0].get_ydata() == pytest.approx(0.002)


@pytest.mark.parametrize("seen", [True, False])
def test_the_acceleration_is_that_which_would_leave_the_deflection(seen: bool) -> None:
    _, acceleration = drawn(ground(seen))
    curve, low = acceleration.lines[0], acceleration.lines[1]
    frequency_hz, level = np.array(curve.get_data(), dtype=np.float64)
    # far above its own frequency the pendulum's base has to move by w^2/w0^2 more than at it
    drive = 0.002 * ARCSEC_RAD * ((2 * np.pi * frequency_hz) ** 2 - (2 * np.pi * PENDULUM_HZ) ** 2)
    assert level == pytest.approx(1e9 * PER_DRIVE * drive)
    at_hz, model = np.array(low.get_data(), dtype=np.float64)
    assert model == pytest.approx(1e9 * density_of_db(nlnm_db(at_hz)))
    marked = [line for line in acceleration.lines if len(line.get_xdata()) == 1]
    assert any(
        line.get_xdata()[0] == PENDULUM_HZ and line.get_ydata()[0] == pytest.approx(600.0 if seen else 720.0)
        for line in marked
    )
