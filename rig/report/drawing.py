"""How figures look, and how they become SVG and PNG: matplotlib without pyplot, no state kept."""

import contextlib
import io
import re
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
from rig.presentation import palette

WIDTH_IN: Final = 7.1
DATA: Final = palette.BLUE
"""Measured points: darker than on the view's dark ground, so that single dots read on paper."""
EXACT: Final = palette.EXACT_FIT_COLOUR
ASYMPTOTIC: Final = palette.ASYMPTOTIC_FIT_COLOUR
SMOOTH: Final = palette.BLUISH_GREEN
INK: Final = "#222831"
_GAP = 5.0
_EDGE_IN = 0.02
_TIMES = 3
"""Marks change with the size of the axes, and with them what room they need."""
_FROM_ZERO = 0.3
"""An axis begins at zero where the lowest value is below this part of the highest."""
_DIGITS: Final = re.compile(r"(\.\d\d)\d+")
_MARKS_OF_ONE: Final = re.compile(r'<g( clip-path="[^"]*")?>\s*((?:<use [^>]*/>\s*)+)</g>')
_MARKS = 3
"""A logarithmic axis has at least so many marks; else a linear one has more."""

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

    def __post_init__(self) -> None:
        with styled():
            _make_room(self.figure)


_STYLING = threading.RLock()


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Figures are made and saved inside this; the style ends with it, also where several threads draw.

    matplotlib has one style for all threads: one that ended for the first would go on for ever for the last.
    """
    with _STYLING, mpl.rc_context(cast(Any, dict(STYLE))):
        yield


def canvas(height_in: float) -> Figure:
    """An empty figure as wide as the page."""
    figure = Figure(figsize=(WIDTH_IN, height_in))
    FigureCanvasAgg(figure)
    return figure


def one_axes(
    height_in: float, x_label: str, y_label: str, *, left: float = 0.12, right: float = 0.97, bottom: float
) -> tuple[Figure, Axes]:
    """A figure with one pair of axes and their labels."""
    figure = canvas(height_in)
    axes = figure.subplots()
    figure.subplots_adjust(left=left, right=right, bottom=bottom, top=0.95)
    axes.set(xlabel=x_label, ylabel=y_label)
    return figure, axes


def three_columns(count: int, rows_in: Callable[[int], float], **margins: float) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels, up to three in a row; `rows_in` is its height by the number of rows."""
    rows = (count + 2) // 3
    figure = canvas(rows_in(rows))
    panels = list(figure.subplots(rows, min(count, 3), squeeze=False).flat)
    figure.subplots_adjust(right=0.985, **margins)
    for spare in panels[count:]:
        spare.set_visible(False)
    return figure, panels[:count]


def svg(drawing: ReportFigure) -> bytes:
    """The figure as SVG; the same figure gives the same bytes."""
    out = io.StringIO()
    with styled():
        about = {"Date": None, "Creator": None, "Format": None, "Type": None, "Title": drawing.title}
        drawing.figure.savefig(out, format="svg", metadata=about)
    return _short(out.getvalue()).encode()


def png(drawing: ReportFigure, dpi: int = 200) -> bytes:
    """The figure as PNG."""
    out = io.BytesIO()
    with styled():
        drawing.figure.savefig(out, format="png", dpi=dpi, metadata={"Software": None})
    return out.getvalue()


def _short(drawn: str) -> str:
    """An SVG of half the length: places to 0.01 pt, equal marks' style once, no indents, short names."""
    drawn = re.sub(r'(?<= )(?:d|x|y)="[^"]*"', lambda found: _DIGITS.sub(r"\1", found[0]), drawn)
    drawn = _MARKS_OF_ONE.sub(_style_once, re.sub(r"\s*\n\s*", "\n", drawn))
    # a line of no length is a dot; behind a line the next one needs no command
    drawn = re.sub(r"M (\S+ \S+)\nL \1(?=\n)", r"M\1h0", drawn)
    drawn = re.sub(r"[ML] \S+ \S+(?:\nL \S+ \S+)+", lambda found: found[0].replace("\nL", ""), drawn)
    used = dict.fromkeys(re.findall(r'(?<=["(]#)[\w.-]+', drawn))
    names = {name: f"i{number:x}" for number, name in enumerate(used)}
    drawn = re.sub(r' id="([^"]*)"', lambda found: f' id="{names.get(found[1], "")}"', drawn)
    drawn = re.sub(r'(?<=["(]#)[\w.-]+', lambda found: names[found[0]], drawn)
    return drawn.replace(' id=""', "")


def _style_once(found: re.Match[str]) -> str:
    styles = set(re.findall(r' style="[^"]*"', found[2]))
    if len(styles) != 1:
        return found[0]
    (style,) = styles
    return f"<g{found[1] or ''}{style}>{found[2].replace(style, '')}</g>"


def _make_room(figure: Figure) -> None:
    """Move the outer edges of the axes inwards where their labels would be cut off, and keep these places."""
    width, height = figure.get_figwidth(), figure.get_figheight()
    for _ in range(_TIMES):
        box, margins = figure.get_tightbbox(), figure.subplotpars
        over = (_EDGE_IN - box.x0, box.x1 - width + _EDGE_IN, _EDGE_IN - box.y0, box.y1 - height + _EDGE_IN)
        left, right, bottom, top = (max(0.0, inches) for inches in over)
        if not any((left, right, bottom, top)):
            for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
                # where a label stands is half of the work of drawing
                place = axis.label.get_transform().transform(axis.label.get_position())
                axis.set_label_coords(*axis.axes.transAxes.inverted().transform(place))
            return
        figure.subplots_adjust(
            left=margins.left + left / width,
            right=margins.right - right / width,
            bottom=margins.bottom + bottom / height,
            top=margins.top - top / height,
        )


def dots(axes: Axes, x: NDArray[Any], y: Floats, colour: str) -> None:
    """Small dots as one line with round ends, of no length at each: a mark each makes a large file."""
    gap = np.full(len(x), np.nan)
    beside = x + 1e-6 * (float(np.ptp(x)) or 1.0)
    ends = np.column_stack([x, beside, gap]).ravel(), np.column_stack([y, y, gap]).ravel()
    axes.plot(*ends, "-", color=colour, lw=2.0, solid_capstyle="round", snap=False)


def envelope(x: Floats, y: Floats, columns: int = 900) -> tuple[Floats, Floats, Floats]:
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


def broken(x: Floats, *columns: Floats) -> tuple[Floats, ...]:
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


def span(axes: Axes, values: Floats, weight_share: float = 0.0, margin: float = 0.07) -> None:
    """Set the y range to the finite values, without the outermost share on either side."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return
    low, high = np.quantile(finite, [weight_share, 1 - weight_share])
    pad = margin * (high - low) or abs(high) * margin or 1.0
    axes.set_ylim(low - pad, high + pad)


def from_data(values: Floats, margin: float = 0.02) -> tuple[float, float]:
    """Limits of an axis of what is never negative: from zero where the values come near it, else theirs."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    pad = margin * (high if low < _FROM_ZERO * high else high - low or high)
    return (0.0 if low < _FROM_ZERO * high else low - pad), high + pad


def amplitude_axis(axes: Axes, low: float, high: float) -> None:
    """The x axis of amplitudes in arcsec: logarithmic with marks at 1, 2, 5, where there are some."""
    axes.set_xlabel("α / arcsec")
    steps = [mark * 10.0**power for power in range(-4, 7) for mark in (1, 2, 5)]
    marks = [mark for mark in steps if 0.9 * low <= mark <= 1.1 * high]
    if len(marks) < _MARKS:
        axes.set_xlim(*from_data(np.array([low, high]), 0.05))
        return
    axes.set_xscale("log")
    axes.set_xticks(marks, [f"{mark:g}" for mark in marks])
    axes.minorticks_off()
    axes.set_xlim(low * 0.9, high * 1.1)
