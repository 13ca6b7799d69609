"""Charts of the desk: each curve is declared by its quantity of the catalogue, which names axis and unit.

They are drawn by ECharts, which is a part of NiceGUI, as SVG; its theme is `static/charts.json`, whose
colours are those of the page. Wheel or fingers zoom; the point under the pointer is shown with its unit.
"""

import json
import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, Literal

from nicegui import ui

from rig.desk.tables import static
from rig.terminal import QuantityDisplay, quantity

Points = Sequence[Sequence[float | None]]
_LABELS_TO_END = 3
"""Labels from the middle of an axis that is to scale to its end."""


@dataclass(frozen=True, slots=True)
class ChartCurve:
    """A curve of a chart."""

    key: str
    """Key of its quantity."""
    name: str = ""
    """Name in the legend, if several curves have one quantity."""
    style: Literal["line", "scatter", "bar"] = "line"
    colour: str = "line"
    """Name of the colour in the theme."""


def chart_options(
    x: QuantityDisplay,
    curves: Sequence[ChartCurve],
    points: Sequence[Points],
    unit: str,
    *,
    reach: float | None = None,
    kind: Literal["wide", "square", "small"] = "wide",
    empty: str = "",
) -> dict[str, Any]:
    """Options for ECharts of a chart over `x`; the other parameters are those of `Chart` and its `show`.

    All options are always named, because the browser merges them with those it has.
    """
    is_square, is_empty = kind == "square", not any(map(len, points))
    step = None if reach is None else reach / _LABELS_TO_END
    to_scale = {"scale": True, "min": None if reach is None else -reach, "max": reach, "interval": step}
    x_axis = {
        "name": x.label,
        "nameLocation": "middle",
        "nameGap": 24,
        "axisLine": {"onZero": False},
        **(to_scale if is_square else {"min": "dataMin", "max": "dataMax"}),
    }
    y = quantity(curves[0].key, unit)
    y_axis = {
        "name": y.label,
        "nameTextStyle": {"align": "left", "padding": [0, 0, 0, -50]},
        "nameGap": 8,
        "splitNumber": 2 if kind == "small" else 5,
        **(to_scale if is_square else {"scale": True}),
    }
    names = list(dict.fromkeys(curve.name for curve in curves if curve.name))
    # a square has no room beside its axis's name
    has_legend = not is_square and len(names) > 1 and not is_empty
    text = {"text": empty if is_empty else "", "fill": "var(--dim)", "fontSize": 15}
    return {
        "animation": False,
        "grid": {"left": 58, "right": 18, "top": 22, "bottom": 42},
        "xAxis": _axis(x.unit, has_ends=reach is not None) | x_axis,
        "yAxis": _axis(y.unit, has_top=is_square) | y_axis,
        "series": [_series(curve, data, unit) for curve, data in zip(curves, points, strict=True)],
        "legend": {"show": has_legend, "data": names, "right": 8, "top": 0},
        "tooltip": {},
        "dataZoom": [
            {"type": "inside", "xAxisIndex": 0, "filterMode": "none"},
            {"type": "inside", "yAxisIndex": 0, "filterMode": "none", "zoomOnMouseWheel": "shift"},
        ],
        "graphic": {"type": "text", "left": "center", "top": "middle", "silent": True, "style": text},
    }


def _axis(unit: str, *, has_ends: bool = True, has_top: bool = True) -> dict[str, Any]:
    """Options common to both axes; labels stand at both ends, at the lower end only, or at none."""
    return {
        "type": "value",
        "axisLabel": {
            ":formatter": _number(""),
            "showMinLabel": has_ends,
            "showMaxLabel": has_ends and has_top,
        },
        "axisPointer": {"label": {":formatter": f"p => ({_number(unit)})(p.value)"}},
    }


def _series(curve: ChartCurve, points: Points, unit: str) -> dict[str, Any]:
    y, colour = quantity(curve.key, unit), {"color": f"var(--{curve.colour})"}
    return {
        "type": curve.style,
        "name": curve.name or y.symbol,
        "lineStyle": colour,
        "itemStyle": colour,
        "tooltip": {":valueFormatter": _number(y.unit)},
        "data": list(points),
    }


def _number(unit: str) -> str:
    """A function of the page that writes a number with its unit."""
    return f"v => window.rigNumber(v, {json.dumps(unit)})"


class Chart:
    """A chart on a panel, whose zoom stays when it is drawn again.

    `title` is its name for screen readers. Both axes of a square chart are equally long, so that curves in
    one unit are to scale if both axes have the same range.
    """

    def __init__(
        self,
        title: str,
        x: str,
        curves: Sequence[ChartCurve],
        kind: Literal["wide", "square", "small"] = "wide",
    ) -> None:
        self._x, self._curves, self._kind = x, curves, kind
        self._shown: object = None
        with ui.element("div").classes(f"chart {kind}") as self.frame:
            with ui.element("div").classes("whole") if kind == "square" else nullcontext():
                self.element = ui.echart({}, renderer="svg", theme=json.loads(static("charts.json")))
            self.element.props(f'role="img" aria-label="{title}"')

    def show(
        self,
        points: Sequence[Points],
        unit: str = "arcsec",
        *,
        reach: float | None = None,
        empty: str = "nothing to draw yet",
    ) -> None:
        """Draw the points of each curve, in the units shown; without points the text `empty`.

        `reach` is the half-length of both axes about zero; None: the axes end with the points.
        """
        content = (tuple(map(tuple, points)), unit, reach)
        if content == self._shown:
            return
        self._shown = content
        x, kind = quantity(self._x, unit), self._kind
        options = chart_options(x, self._curves, points, unit, reach=reach, kind=kind, empty=empty)
        self.element.options.clear()
        self.element.options.update(options)
        self.element.update()


class TrajectoryChart:
    """Path of the spot in a square chart, with equal scales about zero, or with each axis stretched."""

    def __init__(self) -> None:
        self._stretched = False
        self._last: tuple[Sequence[float | None], Sequence[float | None], str] = [], [], "arcsec"
        with ui.row().classes("items-center"):
            ui.label("trajectory").classes("title")
            self._button = ui.button("stretch X", on_click=self._stretch).props("dense outline no-caps")
        self.chart = Chart("trajectory", "deflection_x", TRAJECTORY_CURVES, "square")

    def show(self, x: Sequence[float | None], y: Sequence[float | None], unit: str) -> None:
        """Draw the path; the curve is interrupted where a coordinate is None."""
        self._last = x, y, unit
        path = [
            (None, None) if x_k is None or y_k is None else (x_k, y_k) for x_k, y_k in zip(x, y, strict=True)
        ]
        known = [(x_k, y_k) for x_k, y_k in path if x_k is not None and y_k is not None]
        reach = trajectory_reach(known) if known and not self._stretched else None
        self.chart.show([path if known else [], known[-1:]], unit, reach=reach, empty="no trajectory")

    def _stretch(self) -> None:
        self._stretched = not self._stretched
        self._button.set_text("to scale" if self._stretched else "stretch X")
        self.show(*self._last)


TRAJECTORY_CURVES = (
    ChartCurve("deflection_y", "way of the spot"),
    ChartCurve("deflection_y", "now", style="scatter", colour="second"),
)
"""Curves of a trajectory, over ``deflection_x``."""


def trajectory_reach(known: Sequence[tuple[float, float]]) -> float:
    """Half-length of the axes of a trajectory to scale, rounded up, so that few samples change it."""
    min_step = 1.02 / _LABELS_TO_END * max(max(abs(x), abs(y)) for x, y in known)
    decade = 10.0 ** math.floor(math.log10(min_step or 1.0))
    steps = (digit * decade for digit in (1, 2, 3, 4, 5, 6, 8, 10))
    return _LABELS_TO_END * next(step for step in steps if step >= min_step * (1 - 1e-9))
