"""Analysis of a decaying oscillation: turning points with uncertainties, separation of two modes."""

from processing.swing.cycle_residuals import SHARED, CycleResiduals, CycleWatch
from processing.swing.detector import SwingDetector, compile_kernels, swings_of, swings_of_blocks
from processing.swing.modes import TwoModes, separate_modes
from processing.swing.noise import SampleScatter, estimate_noise, estimate_scatter, with_learned_weights
from processing.swing.prediction import KnownMotion
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
