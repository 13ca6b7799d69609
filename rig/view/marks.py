"""Graticules, the cross at the spot, and colours, as Rerun's archetypes."""

from typing import Final

import rerun as rr

from rig.presentation import palette
from rig.view.graticule import Graticule

BACKGROUND: Final = (18, 20, 24)
GRID_COLOUR: Final = (48, 52, 60)
AXIS_COLOUR: Final = (110, 116, 126)
LABEL_COLOUR: Final = (235, 238, 242)
CROSS_INNER: Final = 0.06
CROSS_OUTER: Final = 0.14
"""Distance from the spot at which the arms of the cross begin and end, as fractions of the image's smaller
side.
"""


def graticule_marks(graticule: Graticule) -> dict[str, rr.AsComponents]:
    """Grid, axes and labels of a graticule, by entity name."""
    grid, axes = graticule.lines()
    labels = graticule.labels()
    return {
        "grid": rr.LineStrips2D(grid, colors=GRID_COLOUR, radii=rr.Radius.ui_points(0.3), draw_order=-20.0),
        "axes": rr.LineStrips2D(axes, colors=AXIS_COLOUR, radii=rr.Radius.ui_points(0.5), draw_order=-10.0),
        "labels": rr.Points2D(
            [(label.x, label.y) for label in labels],
            labels=[label.text for label in labels],
            show_labels=True,
            colors=LABEL_COLOUR,
            radii=rr.Radius.ui_points(0.0),
        ),
    }


def spot_cross(x_px: float, y_px: float, shape: tuple[int, int]) -> rr.LineStrips2D:
    """Four lines that point at the spot without covering it; `shape` is (ny, nx) of the image."""
    inner, outer = CROSS_INNER * min(shape), CROSS_OUTER * min(shape)
    # In Rerun, (0, 0) is the corner of the first pixel; positions of the spot count from its centre.
    x, y = x_px + 0.5, y_px + 0.5
    arms = [
        [(x + dx * inner, y + dy * inner), (x + dx * outer, y + dy * outer)]
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    colour = palette.rgba(palette.VERMILLION)
    return rr.LineStrips2D(arms, colors=[colour], radii=rr.Radius.ui_points(1.0), draw_order=30.0)


def faded(colour: str, part: float) -> tuple[int, int, int]:
    """The colour mixed with the background in the given part.

    It is opaque, because transparent lines would be brighter where they cross.
    """
    own = palette.rgba(colour)[:3]
    red, green, blue = (
        round(part * c + (1 - part) * ground) for c, ground in zip(own, BACKGROUND, strict=True)
    )
    return red, green, blue
