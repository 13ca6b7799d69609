"""Style of figures, their conversion to SVG and PNG, and parts of plots, with matplotlib without pyplot."""

import contextlib
import io
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from processing.arrays import Floats
from rig.terminal import palette

WIDTH_IN: Final = 7.1
DATA: Final = palette.BLUE
"""Colour of measured points: darker than in the view, so that single dots are legible on paper."""
EXACT: Final = palette.EXACT_FIT_COLOUR
ASYMPTOTIC: Final = palette.ASYMPTOTIC_FIT_COLOUR
SMOOTH: Final = palette.BLUISH_GREEN
INK: Final = "#222831"
_MIN_GAP_STEPS = 5.0
"""Smallest gap at which a line is interrupted, in median steps of x."""
_MAX_LOW_FROM_ZERO = 0.3
"""An axis begins at zero if the lowest value is below this fraction of the highest."""
_MIN_LOG_TICKS = 3
"""Fewest ticks of a logarithmic axis; with fewer the axis is linear."""

STYLE: Final[Mapping[str, Any]] = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"], "font.size": 8.5,
    "axes.labelsize": 8.5, "axes.titlesize": 8.5, "axes.titleweight": "normal",
    "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.fontsize": 8,
    "text.color": INK, "axes.edgecolor": INK, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK,
    "axes.linewidth": 0.7, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
    "xtick.direction": "in", "ytick.direction": "in", "xtick.top": True, "ytick.right": True,
    "axes.grid": False, "axes.unicode_minus": True, "lines.linewidth": 1.1, "lines.markersize": 2.4,
    "legend.frameon": False, "legend.handlelength": 1.6,
    "svg.fonttype": "path", "svg.hashsalt": "optical-pendulum-rig",
    "figure.facecolor": "white", "savefig.facecolor": "white",
}  # fmt: skip
"""Settings of matplotlib; text is drawn as shapes, so that an SVG does not need the font."""


@dataclass(frozen=True)
class ReportFigure:
    """A figure with the name of its files, its title and its caption."""

    name: str
    title: str
    caption: str
    figure: Figure
    is_raster: bool = False
    """Whether it is written as PNG, because it shows an image; other figures are written as SVG."""


_STYLE_LOCK = threading.RLock()


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """A context in which figures are drawn and saved in `STYLE`, by one thread at a time.

    matplotlib has one style for all threads: without the lock one thread's style could stay for ever.
    """
    with _STYLE_LOCK, mpl.rc_context(cast(Any, dict(STYLE))):
        yield


def canvas(height_in: float) -> Figure:
    """An empty figure as wide as the page, in which no label is cut."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def one_axes(height_in: float, x_label: str, y_label: str) -> tuple[Figure, Axes]:
    """A figure with one pair of axes and their labels."""
    figure = canvas(height_in)
    axes = figure.subplots()
    axes.set(xlabel=x_label, ylabel=y_label)
    return figure, axes


def three_columns(count: int, rows_in: Callable[[int], float]) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels, up to three in a row; `rows_in` is its height by the number of rows."""
    rows = (count + 2) // 3
    figure = canvas(rows_in(rows))
    panels = list(figure.subplots(rows, min(count, 3), squeeze=False).flat)
    for spare in panels[count:]:
        spare.set_visible(False)
    return figure, panels[:count]


def svg(drawing: ReportFigure) -> bytes:
    """The figure as SVG; the same figure gives the same bytes."""
    buffer = io.StringIO()
    with styled():
        metadata = {"Date": None, "Creator": None, "Format": None, "Type": None, "Title": drawing.title}
        drawing.figure.savefig(buffer, format="svg", metadata=metadata)
    return buffer.getvalue().encode()


def png(drawing: ReportFigure, dpi: int = 200) -> bytes:
    """The figure as PNG."""
    buffer = io.BytesIO()
    with styled():
        drawing.figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def plot_dots(axes: Axes, x: NDArray[Any], y: Floats, colour: str) -> None:
    """Draw small dots as one line with round caps, because separate marks make a large file."""
    gap = np.full(len(x), np.nan)
    x_end = x + 1e-6 * (float(np.ptp(x)) or 1.0)
    ends = np.column_stack([x, x_end, gap]).ravel(), np.column_stack([y, y, gap]).ravel()
    axes.plot(*ends, "-", color=colour, lw=2.0, solid_capstyle="round", snap=False)


def envelope(x: Floats, y: Floats, columns: int = 900) -> tuple[Floats, Floats, Floats]:
    """Smallest and largest y in equal intervals of x, which draw a long oscillation as a band.

    Returns x, low, high; intervals without a finite y are left out. x must increase.
    """
    is_finite = np.isfinite(y)
    x, y = x[is_finite], y[is_finite]
    if len(x) == 0:
        return x, y, y
    edges = np.linspace(x[0], x[-1], min(columns, len(x)) + 1)
    starts = np.unique(np.searchsorted(x, edges[:-1]))
    starts = starts[starts < len(x)]
    return x[starts], np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)


def break_at_gaps(x: Floats, *columns: Floats) -> tuple[Floats, ...]:
    """x and columns with NaN inside every gap (`_MIN_GAP_STEPS`), so that lines end there."""
    if len(x) < 3:
        return x, *columns
    steps = np.diff(x)
    gaps = np.flatnonzero(steps > _MIN_GAP_STEPS * np.median(steps)) + 1
    middles = 0.5 * (x[gaps] + x[gaps - 1])
    return np.insert(x, gaps, middles), *(np.insert(column, gaps, np.nan) for column in columns)


def thinned_indices(count: int, max_count: int) -> NDArray[np.int64]:
    """Indices of at most `max_count` of `count` points, evenly spaced, with the first and the last."""
    if count <= max_count:
        return np.arange(count)
    return np.unique(np.rint(np.linspace(0, count - 1, max_count)).astype(np.int64))


def set_y_range(axes: Axes, values: Floats, omitted_fraction: float = 0.0, margin: float = 0.07) -> None:
    """Set the y range to the finite values, without `omitted_fraction` of them at either end."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return
    low, high = np.quantile(finite, [omitted_fraction, 1 - omitted_fraction])
    pad = margin * (high - low) or abs(high) * margin or 1.0
    axes.set_ylim(low - pad, high + pad)


def nonnegative_limits(values: Floats, margin: float = 0.02) -> tuple[float, float]:
    """Limits of an axis of values that are never negative: from zero, or else their range."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    pad = margin * (high if low < _MAX_LOW_FROM_ZERO * high else high - low or high)
    return (0.0 if low < _MAX_LOW_FROM_ZERO * high else low - pad), high + pad


def amplitude_axis(axes: Axes, low: float, high: float) -> None:
    """Set up the x axis of amplitudes in arcsec: logarithmic with ticks at 1, 2, 5 if there are enough."""
    axes.set_xlabel("α / arcsec")
    steps = [mark * 10.0**power for power in range(-4, 7) for mark in (1, 2, 5)]
    marks = [mark for mark in steps if 0.9 * low <= mark <= 1.1 * high]
    if len(marks) < _MIN_LOG_TICKS:
        axes.set_xlim(*nonnegative_limits(np.array([low, high]), 0.05))
        return
    axes.set_xscale("log")
    axes.set_xticks(marks, [f"{mark:g}" for mark in marks])
    axes.minorticks_off()
    axes.set_xlim(low * 0.9, high * 1.1)
