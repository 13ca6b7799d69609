"""Charts of the desk: each curve is declared by its quantity of the catalogue, which names axis and unit.

They are drawn by ECharts, which NiceGUI brings along, as SVG whose colours are those of the theme. Zoom is by
wheel, fingers or buttons; what is pointed at is shown with its unit; what is seen is kept as PNG or CSV.
"""

import math
from collections.abc import Sequence
from contextlib import nullcontext

from nicegui import ui

from rig.desk.chart_options import Curve, End, Ends, Mark, Points, chart_options, in_last_row
from rig.presentation import quantity


class Chart:
    """A chart on a panel; `show` draws what is given, and leaves a zoom as it is.

    `title` is its name for those who do not see it, too. `square`: both axes are as long, so that curves in
    one unit are to scale where both ends are the same. `tools` are the buttons above it.
    """

    def __init__(
        self,
        title: str,
        x: str,
        curves: Sequence[Curve],
        *,
        logarithmic: bool = False,
        square: bool = False,
        tools: bool = True,
        height: str = "",
    ) -> None:
        self._title, self._x, self._logarithmic, self._square = title, x, logarithmic, square
        self._curves: Sequence[Curve] = curves
        self._shown: object = None
        self._small = bool(height)
        with ui.element("div").classes("chart") as self.frame:
            if tools:
                with ui.element("div").classes("tools"):
                    ui.label(title).classes("title")
                    self.beside = ui.element("span")
                    ui.space()
                    self._buttons = ui.html(sanitize=False)
            with ui.element("div").classes("whole") if square else nullcontext():
                self.element = ui.echart({}, renderer="svg")
            self.element.props(f'role="img" aria-label="{title}"')
            if height:
                self.element.style(f"height: {height}; min-height: 0; flex: 0 0 auto")
                self.frame.style("flex: 0 0 auto; min-height: 0")
            if square:
                self.frame.classes("square")
            if tools:
                self._buttons.set_content(chart_buttons(int(self.element.id), title))

    def declare(self, curves: Sequence[Curve]) -> None:
        """Draw other curves from now on."""
        self._curves = curves

    def show(
        self,
        points: Sequence[Points],
        unit: str = "arcsec",
        *,
        marks: Sequence[Mark] = (),
        ends: Ends | None = None,
        empty: str = "nothing to draw yet",
        below: str = "",
    ) -> None:
        """Draw the points of each curve, in the units shown; `marks` are lines at an x, with words.

        `ends` are those of the axes, of x and of y; `below` is what the last row says while it is empty.
        """
        now = (tuple(self._curves), tuple(map(tuple, points)), unit, tuple(marks), ends, below)
        if now == self._shown:
            return
        self._shown = now
        options = chart_options(
            quantity(self._x, unit), self._curves, points, unit, self._logarithmic, marks, ends, empty
        )
        # a chart in the browser merges what it gets: words go only where others, or none, replace them
        options["graphic"].append(in_last_row(self._curves, below if any(map(len, points)) else ""))
        if self._small:
            for axis in options["yAxis"]:
                axis["splitNumber"] = 2
                # its name stands there
                axis["axisLabel"]["showMaxLabel"] = False
        self.element.options.clear()
        self.element.options.update(options)
        self.element.update()


class Trajectory:
    """The way of the spot in a square chart, to scale about zero or stretched."""

    def __init__(self) -> None:
        self.chart = Chart("trajectory", "deflection_x", WAY, square=True)
        self._stretched = False
        self._last: tuple[Sequence[float | None], Sequence[float | None], str] = [], [], "arcsec"
        with self.chart.beside:
            self._button = ui.button("stretch X", on_click=self._stretch).props("dense outline no-caps")

    def show(self, x: Sequence[float | None], y: Sequence[float | None], unit: str) -> None:
        """Show it; gaps stay open."""
        self._last = x, y, unit
        way = [(a, b) if a is not None and b is not None else (None, None) for a, b in zip(x, y, strict=True)]
        known = [(a, b) for a, b in way if a is not None and b is not None]
        ends = trajectory_ends(known, stretched=self._stretched) if known else None
        way = way if known else []
        self.chart.show([way, known[-1:]], unit, ends=ends, empty="no trajectory")

    def _stretch(self) -> None:
        self._stretched = not self._stretched
        self._button.set_text("to scale" if self._stretched else "stretch X")
        self.show(*self._last)


def trajectory_ends(known: Sequence[tuple[float, float]], *, stretched: bool) -> Ends:
    """Ends of both axes: to scale about zero, or, stretched, each with what there is along it."""
    if stretched:
        return _span([a for a, _ in known]), _span([b for _, b in known])
    largest = _STEPS * _step(1.02 / _STEPS * max(max(abs(a), abs(b)) for a, b in known))
    end = -largest, largest, largest / _STEPS
    return end, end


WAY = (
    Curve("deflection_y", "way of the spot"),
    Curve("deflection_y", "now", style="points", colour="second"),
)
"""Curves of a trajectory, over ``deflection_x``."""


_STEPS = 3
"""Labels from the middle of an axis that is to scale to its end."""


def _span(values: Sequence[float]) -> End:
    """Ends of an axis that holds them."""
    low, high = min(values), max(values)
    step = _step((high - low or 1e-3) / 4)
    return step * math.floor(low / step), step * math.ceil(high / step), step


def _step(least: float) -> float:
    """The least round step that is not smaller: it does not change with every sample."""
    tens = 10.0 ** math.floor(math.log10(least or 1.0))
    return tens * next(one for one in (1, 2, 3, 4, 5, 6, 8, 10) if one * tens >= least * (1 - 1e-9))


def chart_buttons(number: int, title: str) -> str:
    """The buttons of the chart with this number of its element."""
    said = (
        ("in", "+", f"zoom into {title}"),
        ("out", "−", f"zoom out of {title}"),
        ("all", "All", f"All of {title}"),
        ("png", "PNG", f"PNG of {title}"),
        ("csv", "CSV", f"CSV of {title}"),
    )
    return " ".join(
        f'<button type="button" data-chart="{number}" data-do="{do}" aria-label="{words}">{sign}</button>'
        for do, sign, words in said
    )
