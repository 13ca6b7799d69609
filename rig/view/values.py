"""Values shared by the modules of the view: names of layouts and panels, curves, the setup."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

ShowMode = Literal["spawn", "web"]
"""In a window, or in a browser."""
Mode = Literal["none", ShowMode]
"""How a view is shown, if at all."""
LayoutName = Literal["balancing", "measuring", "analysing"]
Panel = Literal["decay", "residuals", "period", "period_residuals"]

Floats = NDArray[np.float64]


class Setup(NamedTuple):
    """Title, layout, expected values and panels that a drawing needs before its first value.

    `runs` are the names of the runs that are overlaid, one empty name for a single run. `period_s` (of the
    slow mode) and `amplitude` (of the first axes) are expected values, `unit` is that of all deflections.
    `parameters`, with their labels, are estimated while the run is measured, and each has a panel of the
    measuring layout. With `has_reference` there is a panel for the spot of a mirror on the base.
    """

    title: str
    layout: LayoutName = "measuring"
    runs: tuple[str, ...] = ("",)
    period_s: float = 4.07
    amplitude: float = 125.0
    unit: str = "arcsec"
    parameters: Mapping[str, str] = {}
    has_reference: bool = False


class AnalysisCurve(NamedTuple):
    """One curve of the analysing layout, drawn as points (data) or as a line (fit); arrays (n,).

    Axes of the panels: ``decay`` time in s, amplitude; ``residuals`` time in s, residual of the amplitude;
    ``period`` amplitude, period in s; ``period_residuals`` amplitude, residual in ms. Amplitudes are in
    the unit of the setup. NaN interrupts a line. `u_y` is drawn as error bars of one standard uncertainty.
    """

    panel: Panel
    name: str
    x: Floats
    y: Floats
    u_y: Floats | None = None
    style: Literal["points", "line"] = "line"


_MAX_DRAWN_U_RELATIVE = 0.5
"""Largest relative uncertainty of a parameter that is drawn."""


def is_drawn(value: float, u: float) -> bool:
    """Whether a parameter is known well enough to be drawn: the first values would hide all later ones."""
    return u <= _MAX_DRAWN_U_RELATIVE * abs(value)
