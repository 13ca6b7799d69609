"""Analysis of a decaying oscillation: turning points with uncertainties, separation of two modes."""

from processing.swing.compilation import compile_kernels
from processing.swing.cycle_residuals import SHARED, CycleResiduals, CycleWatch
from processing.swing.detector import SwingDetector, swings_of, swings_of_blocks
from processing.swing.first_weights import with_learned_weights
from processing.swing.known_motion import KnownMotion
from processing.swing.modes import TwoModes, separate_modes
from processing.swing.noise import SampleScatter, estimate_noise, estimate_scatter
from processing.swing.spectrum import ResidualSpectrum, residual_spectrum
from processing.swing.swing import Swing, SwingFlag, TurningPoints, turning_points
from processing.swing.swing_harmonics import (
    HALVES,
    ORDERS,
    HarmonicClass,
    HarmonicsWatch,
    SwingHarmonics,
    SwingTerms,
    harmonic_classes,
)
