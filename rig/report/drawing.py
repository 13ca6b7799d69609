"""How figures look, and how they become SVG and PNG: matplotlib without pyplot, no state kept."""

import io
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Final, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rig.presentation import palette

Array = NDArray[np.float64]
WIDTH_IN: Final = 7.1
DATA: Final = palette.BLUE
"""Measured points: darker than on the view's dark ground, so that single dots read on paper."""
EXACT: Final = palette.EXACT_FIT_COLOUR
ASYMPTOTIC: Final = palette.ASYMPTOTIC_FIT_COLOUR
SMOOTH: Final = palette.BLUISH_GREEN
INK: Final = "#222831"
_GAP = 5.0

STYLE: Final[Mapping[str, Any]] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.5,
    "axes.labelsize": 8.5,
    "axes.titlesize": 8.5,
    "axes.titleweight": "normal",
    "axes.linewidth": 0.7,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.grid": False,
    "lines.linewidth": 1.1,
    "lines.markersize": 2.4,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.handlelength": 1.6,
    "axes.unicode_minus": True,
    "svg.fonttype": "path",
    "svg.hashsalt": "optical-pendulum-rig",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}
"""Text as shapes: an SVG looks the same where the font is not installed."""


@dataclass(frozen=True)
class ReportFigure:
    """A figure with the name of its files and what is said under it."""

    name: str
    title: str
    caption: str
    figure: Figure


def styled() -> AbstractContextManager[None]:
    """Figures are made and saved inside this; the style ends with it."""
    return mpl.rc_context(cast(Any, dict(STYLE)))


def canvas(height_in: float) -> Figure:
    """An empty figure as wide as the page."""
    figure = Figure(figsize=(WIDTH_IN, height_in))
    FigureCanvasAgg(figure)
    return figure


def svg(drawing: ReportFigure) -> bytes:
    """The figure as SVG; the same figure gives the same bytes."""
    out = io.BytesIO()
    with styled():
        drawing.figure.savefig(
            out, format="svg", metadata={"Date": None, "Creator": None, "Title": drawing.title}
        )
    return out.getvalue()


def png(drawing: ReportFigure, dpi: int = 200) -> bytes:
    """The figure as PNG."""
    out = io.BytesIO()
    with styled():
        drawing.figure.savefig(out, format="png", dpi=dpi, metadata={"Software": None})
    return out.getvalue()


def envelope(x: Array, y: Array, columns: int = 900) -> tuple[Array, Array, Array]:
    """Least and largest y in each of some even stretches of x: a long oscillation as a band.

    Returns x, low, high; stretches without a finite y are left out. x must rise.
    """
    good = np.isfinite(y)
    x, y = x[good], y[good]
    if len(x) == 0:
        return x, y, y
    edges = np.linspace(x[0], x[-1], min(columns, len(x)) + 1)
    starts = np.unique(np.searchsorted(x, edges[:-1]))
    starts = starts[starts < len(x)]
    return x[starts], np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)


def broken(x: Array, *columns: Array) -> tuple[Array, ...]:
    """The same with NaN amid every step of x that is five times the usual one, so that lines end there."""
    if len(x) < 3:
        return x, *columns
    steps = np.diff(x)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    amid = 0.5 * (x[gaps] + x[gaps - 1])
    return np.insert(x, gaps, amid), *(np.insert(column, gaps, np.nan) for column in columns)


def thinned(count: int, most: int) -> NDArray[np.int64]:
    """Positions of at most `most` of `count` points, evenly, first and last among them."""
    if count <= most:
        return np.arange(count)
    return np.unique(np.rint(np.linspace(0, count - 1, most)).astype(np.int64))


def span(axes: Axes, values: Array, weight_share: float = 0.0, margin: float = 0.07) -> None:
    """Set the y range to the finite values, without the outermost share on either side."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return
    low, high = np.quantile(finite, [weight_share, 1 - weight_share])
    pad = margin * (high - low) or abs(high) * margin or 1.0
    axes.set_ylim(low - pad, high + pad)
