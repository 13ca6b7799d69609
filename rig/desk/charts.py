"""Charts of the desk: each curve is declared by its quantity of the catalogue, which names axis and unit.

They are drawn by ECharts, which NiceGUI brings along, as SVG whose colours are those of the theme. Zoom is by
wheel or fingers; what is pointed at is shown with its unit.
"""

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, Final, Literal

from nicegui import ui

from rig.presentation import QuantityDisplay, quantity

Points = Sequence[Sequence[float | None]]
Mark = tuple[float, str]
_TEXT = {"color": "var(--dim)", "fontSize": 12}
_NAME_PERCENT, _BELOW_PERCENT = 10.0, 18.0
"""Of a chart with several rows: what the name above a row takes, and labels and name below the last one."""
_EDGE = {"lineStyle": {"color": "var(--edge)"}}
_LINES = {"lineStyle": {"color": "var(--edge)", "opacity": 0.35}}
_BOX = {"backgroundColor": "var(--raised)", "color": "var(--ink)"}
_TYPES: Final[Mapping[str, Mapping[str, Any]]] = {
    "line": {"type": "line", "symbol": "none"},
    "points": {"type": "scatter", "symbol": "circle", "symbolSize": 5},
    "bars": {"type": "bar", "barCategoryGap": "10%"},
}


@dataclass(frozen=True, slots=True)
class ChartCurve:
    """A curve: the key of its quantity, its name where several have one quantity, how it is drawn.

    `colour` is a name of the theme. Curves with another `row` are drawn below each other, over the same x.
    """

    key: str
    name: str = ""
    style: Literal["line", "points", "bars"] = "line"
    colour: str = "line"
    row: int = 0


def chart_options(
    x: QuantityDisplay,
    curves: Sequence[ChartCurve],
    points: Sequence[Points],
    unit: str,
    *,
    marks: Sequence[Mark] = (),
    reach: float | None = None,
    is_square: bool = False,
    empty: str = "",
) -> dict[str, Any]:
    """Options of a chart over `x` that is `is_square` or not; `Chart.show` says what the rest is."""
    last = max(curve.row for curve in curves)
    nothing = not any(len(one) for one in points)
    part = (100.0 - _BELOW_PERCENT) / (last + 1)
    grids, x_axes, y_axes = [], [], []
    for row in range(last + 1):
        # labels below the last one only; above each row there is room for its name
        inside = (
            {"top": f"{_NAME_PERCENT + row * part:.1f}%", "height": f"{part - _NAME_PERCENT:.1f}%"}
            if last
            else {"top": 22, "bottom": 42}
        )
        grids.append({"left": 58, "right": 18, **inside})
        across = {
            **_axis(x, row, is_labelled=row == last, has_ends=reach is not None),
            **({"scale": True, **_from_to(reach)} if is_square else _whole(points)),
            "name": x.label if row == last else "",
            "nameLocation": "middle",
            "nameGap": 24,
            "axisLine": {**_EDGE, "onZero": False},
        }
        x_axes.append(across)
        shown = quantity(next(curve.key for curve in curves if curve.row == row), unit)
        up = {
            # where rows lie close the ends of one meet those of the next
            **_axis(shown, row, has_ends=not last),
            "scale": True,
            **(_from_to(reach) if is_square else {}),
            "name": shown.label,
            "nameTextStyle": {**_TEXT, "align": "left", "padding": [0, 0, 0, -50]},
            "nameGap": 8,
            "splitNumber": 2 if last else 5,
        }
        y_axes.append(up)
    series = [_series(curve, one, unit) for curve, one in zip(curves, points, strict=True)]
    if marks and not nothing:
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
    named = not is_square and len(names) > 1 and not nothing
    every = list(range(last + 1))
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
        # a chart in the browser merges what it gets: words go only where others, or none, replace them
        "graphic": {
            "type": "text",
            "left": "center",
            "top": "middle",
            "silent": True,
            "style": {"text": empty if nothing else "", "fill": "var(--dim)", "fontSize": 15},
        },
    }


def _axis(
    shown: QuantityDisplay, row: int, *, is_labelled: bool = True, has_ends: bool = True
) -> dict[str, Any]:
    """What both axes of a row have; `has_ends`: there are labels at its ends."""
    return {
        "type": "value",
        "gridIndex": row,
        "nameTextStyle": _TEXT,
        "axisLine": _EDGE,
        "splitLine": _LINES,
        "axisLabel": {
            **_TEXT,
            ":formatter": _number(""),
            "hideOverlap": True,
            "show": is_labelled,
            "showMinLabel": has_ends,
            "showMaxLabel": has_ends,
        },
        "axisPointer": {"label": {":formatter": f"p => ({_number(shown.unit)})(p.value)", **_BOX}},
    }


def _whole(points: Sequence[Points]) -> dict[str, float]:
    """From the first to the last x of all curves: rows below each other have one."""
    every = [x for curve in points for x, *_ in curve if x is not None]
    return {"min": min(every), "max": max(every)} if every else {}


def _from_to(reach: float | None) -> dict[str, float | None]:
    """As far to both sides of zero, with labels at both ends; None: as far as ECharts finds anything."""
    # the browser merges options: ends that are no longer named would stay
    low, step = (None, None) if reach is None else (-reach, reach / _STEPS)
    return {"min": low, "max": reach, "interval": step}


def _series(curve: ChartCurve, points: Points, unit: str) -> dict[str, Any]:
    """One curve for ECharts."""
    shown, colour = quantity(curve.key, unit), f"var(--{curve.colour})"
    return {
        **_TYPES[curve.style],
        "name": curve.name or shown.symbol,
        "xAxisIndex": curve.row,
        "yAxisIndex": curve.row,
        "emphasis": {"disabled": True},
        "lineStyle": {"color": colour, "width": 1.5},
        "itemStyle": {"color": colour},
        "tooltip": {":valueFormatter": _number(shown.unit)},
        "data": list(points),
    }


def _number(unit: str) -> str:
    """A function of the page that writes a number with its unit."""
    return f"v => window.rigNumber(v, {json.dumps(unit)})"


class Chart:
    """A chart on a panel; `show` draws what is given, and leaves a zoom as it is.

    `title` is its name for those who do not see it, too. `square`: both axes are as long, so that curves in
    one unit are to scale where both reach as far. One with a `height` has no title above it.
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
        self._x, self._curves, self._is_square = x, curves, square
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

    def show(
        self,
        points: Sequence[Points],
        unit: str = "arcsec",
        *,
        marks: Sequence[Mark] = (),
        reach: float | None = None,
        empty: str = "nothing to draw yet",
    ) -> None:
        """Draw the points of each curve, in the units shown; `marks` are lines at an x, with words.

        `reach` is how far both axes go from zero; None: as far as there is anything.
        """
        now = (tuple(map(tuple, points)), unit, tuple(marks), reach)
        if now == self._shown:
            return
        self._shown = now
        options = chart_options(
            quantity(self._x, unit),
            self._curves,
            points,
            unit,
            marks=marks,
            reach=reach,
            is_square=self._is_square,
            empty=empty,
        )
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
        reach = trajectory_reach(known) if known and not self._stretched else None
        self.chart.show([way if known else [], known[-1:]], unit, reach=reach, empty="no trajectory")

    def _stretch(self) -> None:
        self._stretched = not self._stretched
        self._button.set_text("to scale" if self._stretched else "stretch X")
        self.show(*self._last)


WAY = (
    ChartCurve("deflection_y", "way of the spot"),
    ChartCurve("deflection_y", "now", style="points", colour="second"),
)
"""Curves of a trajectory, over ``deflection_x``."""
_STEPS = 3
"""Labels from the middle of an axis that is to scale to its end."""


def trajectory_reach(known: Sequence[tuple[float, float]]) -> float:
    """How far the axes of a trajectory that is to scale go: it does not change with every sample."""
    least = 1.02 / _STEPS * max(max(abs(a), abs(b)) for a, b in known)
    tens = 10.0 ** math.floor(math.log10(least or 1.0))
    return _STEPS * tens * next(one for one in (1, 2, 3, 4, 5, 6, 8, 10) if one * tens >= least * (1 - 1e-9))
