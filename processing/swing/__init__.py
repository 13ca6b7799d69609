"""Swings of a decay: turning points with uncertainties, separation of the two modes."""

from processing.swing.detector import SwingDetector
from processing.swing.known import KnownMotion
from processing.swing.noise import estimate_noise
from processing.swing.preparation import prepare
from processing.swing.swing import SWING_DTYPE, Swing, SwingFlag, TurningPoints, turning_points

__all__ = [
    "SWING_DTYPE",
    "KnownMotion",
    "Swing",
    "SwingDetector",
    "SwingFlag",
    "TurningPoints",
    "estimate_noise",
    "prepare",
    "turning_points",
]
