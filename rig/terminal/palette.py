"""Colours of view and report, which colour-deficient eyes can distinguish.

They are the eight colours of Okabe and Ito, "Color Universal Design" (2008), as hexadecimal sRGB, with
meanings that are the same in every figure and panel.
"""

from typing import Final

from processing.estimate import FitMethod

ORANGE: Final = "#E69F00"
SKY_BLUE: Final = "#56B4E9"
BLUISH_GREEN: Final = "#009E73"
YELLOW: Final = "#F0E442"
BLUE: Final = "#0072B2"
VERMILLION: Final = "#D55E00"
REDDISH_PURPLE: Final = "#CC79A7"
GREY: Final = "#8A8F98"

X_COLOUR: Final = ORANGE
"""The fast mode, in X(t)."""
Y_COLOUR: Final = SKY_BLUE
"""Y(t), the slow mode."""
TRAJECTORY_COLOUR: Final = YELLOW
"""The last two periods of (X, Y)."""
AMPLITUDE_COLOUR: Final = SKY_BLUE
PERIOD_COLOUR: Final = BLUISH_GREEN
DATA_COLOUR: Final = SKY_BLUE
EXACT_FIT_COLOUR: Final = VERMILLION
ASYMPTOTIC_FIT_COLOUR: Final = REDDISH_PURPLE
LOSSES: Final = (VERMILLION, ORANGE, REDDISH_PURPLE, YELLOW)
"""Counts of losses."""

SEQUENCE: Final = (SKY_BLUE, ORANGE, BLUISH_GREEN, VERMILLION, YELLOW, REDDISH_PURPLE, BLUE, GREY)
"""Colours of all other curves, in this order."""


def curve_colour(name: str, number: int) -> str:
    """Colour of a curve of the analysis: fixed for data and the two fits, else that of `number`."""
    for method, colour in (
        (FitMethod.EXACT, EXACT_FIT_COLOUR),
        (FitMethod.ASYMPTOTIC, ASYMPTOTIC_FIT_COLOUR),
        ("measured", DATA_COLOUR),
    ):
        if method in name.lower():
            return colour
    return SEQUENCE[number % len(SEQUENCE)]


def rgba(colour: str) -> tuple[int, int, int, int]:
    """Red, green, blue and opacity, each 0 to 255, of an opaque ``#RRGGBB`` colour."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue, 255
