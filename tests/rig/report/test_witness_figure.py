"""The picture of what a witness explains: the numbers in it."""

import numpy as np
import pytest

from processing.fit import SeismometerSpectra
from rig.report.figures_motion import witness_figure

FREQUENCY_HZ = (0.20, 0.22, 0.24, 0.26, 0.28)
SPECTRA = SeismometerSpectra(
    frequency_hz=FREQUENCY_HZ,
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
    assert drawn["measurement alone"].get_xdata() == pytest.approx(np.delete(FREQUENCY_HZ, 2))
    assert coherence.lines[0].get_ydata() == pytest.approx(SPECTRA.coherence)
    assert coherence.lines[1].get_ydata()[0] == pytest.approx(1 / 8)
    assert drive.get_xlim() == pytest.approx((0.20, 0.28))
