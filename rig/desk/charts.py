"""Charts of the desk: each curve is declared by its quantity of the catalogue, which names axis and unit.

They are drawn by ECharts, which NiceGUI brings along, as SVG whose colours are those of the theme. Zoom is by
wheel or fingers; what is pointed at is shown with its unit.
"""

import json
import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, Literal

from nicegui import ui

from rig.presentation import QuantityDisplay, quantity

Points = Sequence[Sequence[float | None]]
Mark = tuple[float, str]
End = tuple[float, float, float]
Ends = tuple[End, End]
"""Of x and of y: the lowest, the highest, and the step between labels, of which both are multiples."""
_TEXT = {"color": "var(--dim)", "fontSize": 12}
_NAME_PERCENT, _BELOW_PERCENT = 10.0, 18.0
"""Of a chart with several rows: what the name above a row takes, and labels and name below the last one."""
_LINES = {"lineStyle": {"color": "var(--edge)", "opacity": 0.35}}


@dataclass(frozen=True, slots=True)
class ChartCurve:
    """A curve: the key of its quantity, its name where several have one quantity, how it is drawn.

    `colour` is a name of the theme. A band has points (x, middle, half width). Curves with another `row` are
    drawn below each other, over the same x.
    """

    key: str
    name: str = ""
    style: Literal["line", "points", "band", "bars"] = "line"
    colour: str = "line"
    row: int = 0


def chart_options(
    x: QuantityDisplay,
    curves: Sequence[ChartCurve],
    points: Sequence[Points],
    unit: str,
    marks: Sequence[Mark],
    ends: Ends | None,
    empty: str,
) -> dict[str, Any]:
    """Options of a chart over `x`; `Chart.show` says what the rest is."""
    rows = max((curve.row for curve in curves), default=0) + 1
    nothing = not any(len(one) for one in points)
    labels = {
        **_TEXT,
        ":formatter": _number(""),
        "hideOverlap": True,
        "showMinLabel": ends is not None,
        "showMaxLabel": ends is not None,
    }
    across = {
        "type": "value",
        "nameLocation": "middle",
        "nameGap": 24,
        **(_whole(points) if ends is None else _from_to(ends[0])),
        "axisLine": {"lineStyle": {"color": "var(--edge)"}, "onZero": False},
        "splitLine": _LINES,
        "nameTextStyle": _TEXT,
        "axisPointer": {"label": {":formatter": f"p => ({_number(x.unit)})(p.value)", **_BOX}},
    }
    grids, x_axes, y_axes = [], [], []
    alone = rows == 1
    for row in range(rows):
        last = row == rows - 1
        key = next(curve.key for curve in curves if curve.row == row)
        # labels below the last one only; above each row there is room for its name
        part = (100.0 - _BELOW_PERCENT) / rows
        grids.append(
            {
                "left": 58,
                "right": 18,
                "top": 22 if alone else f"{_NAME_PERCENT + row * part:.1f}%",
                **({"bottom": 42} if alone else {"height": f"{part - _NAME_PERCENT:.1f}%"}),
            }
        )
        x_axes.append(
            {
                **across,
                "gridIndex": row,
                "name": x.label if last else "",
                "axisLabel": {**labels, "show": last},
            }
        )
        shown = quantity(key, unit)
        y_axes.append(
            {
                "type": "value",
                "gridIndex": row,
                "scale": True,
                "name": shown.label,
                "nameTextStyle": {**_TEXT, "align": "left", "padding": [0, 0, 0, -50]},
                "nameGap": 8,
                **({} if ends is None else _from_to(ends[1])),
                # where rows lie close the ends of one meet those of the next
                "axisLabel": {**labels, "showMinLabel": alone, "showMaxLabel": alone},
                "axisLine": {"lineStyle": {"color": "var(--edge)"}},
                "splitLine": _LINES,
                "splitNumber": 5 if alone else 2,
                "axisPointer": {"label": {":formatter": f"p => ({_number(shown.unit)})(p.value)", **_BOX}},
            }
        )
    series = [one for k, curve in enumerate(curves) for one in _series(curve, points[k], unit)]
    if marks and series and not nothing:
        series[0]["markLine"] = {
            "symbol": "none",
            "silent": False,
            "label": {"show": False},
            "emphasis": {"label": {"show": True, "formatter": "{b}", "color": "var(--ink)"}},
            "lineStyle": {"color": "var(--warn)", "type": "dotted", "width": 1.5},
            "data": [{"xAxis": at, "name": words} for at, words in marks],
        }
    # a square has no room beside its axis's name
    names = list(dict.fromkeys(curve.name for curve in curves if curve.name))
    named = ends is None and len(names) > 1 and not nothing
    every = list(range(rows))
    return {
        "animation": False,
        "grid": grids,
        "xAxis": x_axes,
        "yAxis": y_axes,
        "series": series,
        "legend": {"show": named, "data": names, "right": 8, "top": 0, "textStyle": _TEXT, "itemHeight": 8},
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "tooltip": {
            "trigger": "axis",
            "axisPointer": {"type": "cross", "lineStyle": {"color": "var(--dim)"}},
            "confine": True,
            "backgroundColor": "var(--raised)",
            "borderColor": "var(--edge)",
            "textStyle": {"color": "var(--ink)"},
        },
        "dataZoom": [
            {"type": "inside", "xAxisIndex": every, "filterMode": "none"},
            {"type": "inside", "yAxisIndex": every, "filterMode": "none", "zoomOnMouseWheel": "shift"},
        ],
        "graphic": [_words(empty if nothing else "", "middle", 15)],
    }


def in_last_row(curves: Sequence[ChartCurve], words: str) -> dict[str, Any]:
    """Words in the middle of the last row."""
    rows = max((curve.row for curve in curves), default=0) + 1
    part = (100.0 - _BELOW_PERCENT) / rows
    return _words(words, f"{100.0 - _BELOW_PERCENT - 0.5 * (part - _NAME_PERCENT):.1f}%", 13)


def _words(text: str, top: str, size: int) -> dict[str, Any]:
    style = {"text": text, "fill": "var(--dim)", "fontSize": size}
    return {"type": "text", "left": "center", "top": top, "silent": True, "style": style}


def _whole(points: Sequence[Points]) -> dict[str, float]:
    """From the first to the last x of all curves: rows below each other have one."""
    every = [x for curve in points for x, *_ in curve if x is not None]
    return {"min": min(every), "max": max(every)} if every else {}


def _from_to(end: End) -> dict[str, float]:
    return dict(zip(("min", "max", "interval"), end, strict=True))


_BOX = {"backgroundColor": "var(--raised)", "color": "var(--ink)"}


def _series(curve: ChartCurve, points: Points, unit: str) -> list[dict[str, Any]]:
    """One curve for ECharts; a band is drawn as its lower edge, and what is stacked on that."""
    shown, colour = quantity(curve.key, unit), f"var(--{curve.colour})"
    name = curve.name or shown.symbol
    common: dict[str, Any] = {
        "name": name,
        "xAxisIndex": curve.row,
        "yAxisIndex": curve.row,
        "type": "line",
        "symbol": "none",
        "emphasis": {"disabled": True},
        "lineStyle": {"color": colour, "width": 1.5},
        "itemStyle": {"color": colour},
        "tooltip": {":valueFormatter": _number(shown.unit)},
    }
    if curve.style == "points":
        return [{**common, "type": "scatter", "symbol": "circle", "symbolSize": 5, "data": list(points)}]
    if curve.style == "bars":
        return [{**common, "type": "bar", "barCategoryGap": "10%", "data": list(points)}]
    if curve.style == "band":
        edge = {
            **common,
            "stack": f"{curve.key}{curve.row}",
            "stackStrategy": "all",
            "tooltip": {"show": False},
        }
        edge["lineStyle"] = {"opacity": 0}
        low = [(x, None if y is None else y - (u or 0.0)) for x, y, u in points]
        wide = [(x, 2 * (u or 0.0)) for x, _, u in points]
        return [
            {**edge, "data": low},
            {**edge, "data": wide, "areaStyle": {"color": colour, "opacity": 0.3}},
            {**common, "data": [(x, y) for x, y, _ in points]},
        ]
    return [{**common, "data": list(points)}]


def _number(unit: str) -> str:
    """A function of the page that writes a number with its unit."""
    return f"v => window.rigNumber(v, {json.dumps(unit)})"


class Chart:
    """A chart on a panel; `show` draws what is given, and leaves a zoom as it is.

    `title` is its name for those who do not see it, too. `square`: both axes are as long, so that curves in
    one unit are to scale where both ends are the same. One with a `height` has no title above it.
    """

    def __init__(
        self,
        title: str,
        x: str,
        curves: Sequence[ChartCurve],
        *,
        square: bool = False,
        height: str = "",
    ) -> None:
        self._x = x
        self._curves: Sequence[ChartCurve] = curves
        self._shown: object = None
        self._small = bool(height)
        with ui.element("div").classes("chart") as self.frame:
            if not height:
                with ui.row().classes("items-center") as self.head:
                    ui.label(title).classes("title")
            with ui.element("div").classes("whole") if square else nullcontext():
                self.element = ui.echart({}, renderer="svg")
            self.element.props(f'role="img" aria-label="{title}"')
            if height:
                self.element.style(f"height: {height}; min-height: 0; flex: 0 0 auto")
                self.frame.style("flex: 0 0 auto; min-height: 0")
            if square:
                self.frame.classes("square")

    def declare(self, curves: Sequence[ChartCurve]) -> None:
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
        options = chart_options(quantity(self._x, unit), self._curves, points, unit, marks, ends, empty)
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


class TrajectoryChart:
    """The way of the spot in a square chart, to scale about zero or stretched."""

    def __init__(self) -> None:
        self.chart = Chart("trajectory", "deflection_x", WAY, square=True)
        self._stretched = False
        self._last: tuple[Sequence[float | None], Sequence[float | None], str] = [], [], "arcsec"
        with self.chart.head:
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
    ChartCurve("deflection_y", "way of the spot"),
    ChartCurve("deflection_y", "now", style="points", colour="second"),
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
