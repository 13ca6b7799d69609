"""The pictures of ground and seismometer: the numbers in them."""

import numpy as np
import pytest

from processing.estimate import Estimate
from processing.fit import BaseMotion, Ground, SeismometerSpectra
from processing.noise_models import density_of_db, nlnm_db
from processing.swing import ResidualSpectrum
from processing.units import ARCSEC_RAD
from rig.report.figures_motion import spectrum_figure, witness_figure

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


NEAR_HZ = (0.20, 0.22, 0.24, 0.26, 0.28)
SPECTRA = SeismometerSpectra(
    frequency_hz=NEAR_HZ,
    pendulum_rad_per_s2_rthz=(5e-8, 4e-8, 3e-8, 4e-8, 6e-8),
    witness_rad_per_s2_rthz=(4e-8, 3.9e-8, 3e-8, 3.9e-8, 5e-8),
    left_rad_per_s2_rthz=(1e-8, 5e-9, 1e-9, 6e-9, 1.1e-8),
    measurement_rad_per_s2_rthz=(8e-9, 4e-9, 0.0, 4e-9, 8e-9),
    coherence=(0.9, 0.97, 0.999, 0.96, 0.91),
    stretches=8,
    coherence_near=0.99,
)


def test_every_spectrum_is_drawn_over_its_frequencies() -> None:
    drive, coherence = witness_figure(SPECTRA).figure.axes
    drawn = {line.get_label(): line for line in drive.lines}
    assert drawn["pendulum"].get_ydata() == pytest.approx(SPECTRA.pendulum_rad_per_s2_rthz)
    assert drawn["witness"].get_ydata() == pytest.approx(SPECTRA.witness_rad_per_s2_rthz)
    assert drawn["what is left"].get_ydata() == pytest.approx(SPECTRA.left_rad_per_s2_rthz)
    # none at the pendulum's frequency, where a logarithm has no place for it
    assert drawn["measurement alone"].get_xdata() == pytest.approx(np.delete(NEAR_HZ, 2))
    assert coherence.lines[0].get_ydata() == pytest.approx(SPECTRA.coherence)
    assert coherence.lines[1].get_ydata()[0] == pytest.approx(1 / 8)
    assert drive.get_xlim() == pytest.approx((0.20, 0.28))
