"""Analysis of a decaying oscillation: turning points with uncertainties, separation of two modes."""

from processing.swing.cycle_residuals import SHARED_PARAMETERS, CycleExtractor, CycleResiduals
from processing.swing.detector import (
    TurningPointDetector,
    compile_kernels,
    half_cycles_of,
    half_cycles_of_blocks,
)
from processing.swing.half_cycle_harmonics import (
    ORDERS,
    PIECE_HALF_CYCLES,
    HarmonicsMeasurement,
    HarmonicTerms,
    PieceHarmonics,
)
from processing.swing.modes import TwoModes, separate_modes
from processing.swing.noise import SampleScatter, estimate_noise, estimate_scatter, with_learned_weights
from processing.swing.prediction import KnownMotion
from processing.swing.turning_point import HalfCycle, HalfCycleFlag, TurningPoints, turning_points
