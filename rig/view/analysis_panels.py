"""Curves of the analysing layout: XY plots drawn in Spatial2DViews with their own axes."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import rerun as rr

from rig.presentation import palette
from rig.view import layout
from rig.view.graticule import Graticule
from rig.view.marks import faded, graticule_marks
from rig.view.values import Curve, Panel

TITLES: Final[dict[Panel, tuple[str, str]]] = {
    "decay": ("time / s", "amplitude / {unit}"),
    "residuals": ("time / s", "residual / {unit}"),
    "period": ("amplitude / {unit}", "period / s"),
    "period_residuals": ("amplitude / {unit}", "residual / ms"),
}
TRIMMED: Final = frozenset({"period", "period_residuals"})
"""Panels whose values become very uncertain at small amplitudes: these few points do not set the axes."""
RISING: Final = "period"
"""The panel whose curves rise to the right: its legend is in the lower right corner, not the upper."""
COINCIDING: Final = frozenset({"decay", "period"})
"""Panels in which a good fit covers its data: curves drawn first are wider, so that they remain visible."""
BARS_AT_MOST: Final = 400
"""Largest number of error bars of one curve."""


def draw_fits(stream: rr.RecordingStream, drawn: Sequence[Curve], text: str, run: str, unit: str) -> None:
    """Draw axes and curves of each panel, and the report's text (Markdown).

    They are static entities (without a time), as they hold for the whole run.
    """
    for panel, (x_title, y_title) in TITLES.items():
        curves = [curve for curve in drawn if curve.panel == panel]
        if not curves:
            continue
        graticule = Graticule.boxed(
            np.concatenate([curve.x for curve in curves]),
            np.concatenate([curve.y for curve in curves]),
            x_title.format(unit=unit),
            y_title.format(unit=unit),
            trimmed=panel in TRIMMED,
        )
        root = layout.entity(run, f"{layout.ANALYSIS_ROOT}/{panel}")
        for name, archetype in graticule_marks(graticule).items():
            stream.log(f"{root}/axes/{name}", archetype, static=True)
        entries = []
        for number, curve in enumerate(curves):
            colour = palette.curve_colour(curve.name, number)
            later = curves[number + 1 :] if panel in COINCIDING else []
            following = sum(other.style == "line" for other in later)
            outside = _draw_curve(stream, root, curve, graticule, colour, following)
            entries.append((f"{curve.name} ({outside} outside)" if outside else curve.name, colour))
        legend = _legend(entries, graticule, below=panel == RISING)
        stream.log(f"{root}/legend", legend, static=True)
    if text:
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        stream.log(layout.entity(run, layout.REPORT), document, static=True)


def _draw_curve(
    stream: rr.RecordingStream,
    root: str,
    curve: Curve,
    graticule: Graticule,
    colour: str,
    following: int,
) -> int:
    """Draw the part of a curve within the axes; return the number of points outside (0 for lines).

    `following` is the number of lines that are drawn over this curve, which is made wider for them.
    """
    path = f"{root}/{rr.escape_entity_path_part(curve.name)}"
    points = graticule.place(curve.x, curve.y)
    inside = graticule.inside(curve.x, curve.y)
    if curve.style == "points":
        radius = rr.Radius.ui_points(1.2 + 0.7 * following)
        dots = rr.Points2D(points[inside], colors=palette.rgba(colour), radii=radius, draw_order=5.0)
        stream.log(path, dots, static=True)
    else:
        edges = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False])).astype(np.int8)))
        strips = [points[start:stop] for start, stop in edges.reshape(-1, 2)]
        radius = rr.Radius.ui_points(0.8 + 0.8 * following)
        order = 20.0 - following
        line = rr.LineStrips2D(strips, colors=palette.rgba(colour), radii=radius, draw_order=order)
        stream.log(path, line, static=True)
    if curve.u_y is not None:
        rows = np.flatnonzero(inside)[:: max(1, int(inside.sum()) // BARS_AT_MOST)]
        low = np.maximum(curve.y[rows] - curve.u_y[rows], graticule.y_low)
        high = np.minimum(curve.y[rows] + curve.u_y[rows], graticule.y_high)
        ends = graticule.place(curve.x[rows], low), graticule.place(curve.x[rows], high)
        bars = rr.LineStrips2D(
            np.stack(ends, axis=1),
            colors=faded(colour, 0.45),
            radii=rr.Radius.ui_points(0.4),
            draw_order=-5.0,
        )
        stream.log(f"{path}/u", bars, static=True)
    return int(np.count_nonzero(np.isfinite(curve.x + curve.y) & ~inside)) if curve.style == "points" else 0


def _legend(entries: list[tuple[str, str]], graticule: Graticule, *, below: bool) -> rr.Points2D:
    """The names of the curves in their colours, in the upper right corner, or in the lower one if `below`."""
    width, height = graticule.size
    corner = graticule.place(np.array([graticule.x_high]), np.array([graticule.y_high]))[0]
    first = 1.0 - 0.08 * len(entries) - 0.03 if below else 0.03
    places = [
        (corner[0] - 0.2 * width, corner[1] + (first + 0.08 * row) * height) for row in range(len(entries))
    ]
    return rr.Points2D(
        places,
        labels=[name for name, _ in entries],
        show_labels=True,
        colors=[palette.rgba(colour) for _, colour in entries],
        radii=rr.Radius.ui_points(0.0),
    )
