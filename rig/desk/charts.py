"""Charts of the desk: each curve is declared by its quantity of the catalogue, which names axis and unit.

They are drawn by ECharts, which NiceGUI brings along, as SVG whose colours are those of the theme. Zoom is by
wheel, fingers or buttons; what is pointed at is shown with its unit; what is seen is kept as PNG or CSV.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from nicegui import ui

from rig.presentation import Shown, quantity

Points = Sequence[Sequence[float | None]]
Mark = tuple[float, str]
Ends = tuple[tuple[float, float], tuple[float, float]]
_TEXT = {"color": "var(--dim)", "fontSize": 12}
_LINES = {"lineStyle": {"color": "var(--edge)", "opacity": 0.35}}


@dataclass(frozen=True, slots=True)
class Curve:
    """A curve: the key of its quantity, its name where several have one quantity, how it is drawn.

    `colour` is a name of the theme. A band has points (x, middle, half width). Curves with another `row` are
    drawn below each other, over the same x.
    """

    key: str
    name: str = ""
    style: Literal["line", "points", "dashed", "band", "bars", "intervals"] = "line"
    colour: str = "line"
    row: int = 0


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
            self.element = ui.echart({}, renderer="svg")
            self.element.props(f'role="img" aria-label="{title}"')
            if height:
                self.element.style(f"height: {height}; min-height: 0; flex: 0 0 auto")
                self.frame.style("flex: 0 0 auto; min-height: 0")
            if square:
                self.element.style("aspect-ratio: 1; min-height: 0; flex: 0 0 auto; margin: 0 auto")
            if tools:
                self._buttons.set_content(_buttons(int(self.element.id), title))

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
    ) -> None:
        """Draw the points of each curve, in the units shown; `marks` are lines at an x, with words.

        `ends` are those of the axes, of x and of y.
        """
        now = (tuple(self._curves), tuple(map(tuple, points)), unit, tuple(marks), ends)
        if now == self._shown:
            return
        self._shown = now
        options = _options(
            quantity(self._x, unit), self._curves, points, unit, self._logarithmic, marks, ends, empty
        )
        if self._small:
            for axis in options["yAxis"]:
                axis["splitNumber"] = 2
        self.element.options.clear()
        self.element.options.update(options)
        self.element.update()


def trajectory(
    chart: Chart, x: Sequence[float | None], y: Sequence[float | None], unit: str, *, stretched: bool
) -> None:
    """Show the way of the spot in a square chart. Gaps stay open.

    To scale it is seen about zero; stretched, each axis has what there is along it.
    """
    way = [(a, b) if a is not None and b is not None else (None, None) for a, b in zip(x, y, strict=True)]
    known = [(a, b) for a, b in way if a is not None and b is not None]
    ends = None
    if known:
        if stretched:
            ends = _span([a for a, _ in known]), _span([b for _, b in known])
        else:
            largest = _end(max(max(abs(a), abs(b)) for a, b in known))
            ends = (-largest, largest), (-largest, largest)
    chart.show([way, known[-1:]], unit, ends=ends, empty="no trajectory yet")


WAY = (
    Curve("deflection_y", "way of the spot"),
    Curve("deflection_y", "now", style="points", colour="second"),
)
"""Curves of a trajectory, over ``deflection_x``."""


def _span(values: Sequence[float]) -> tuple[float, float]:
    """Ends of an axis that holds them, at steps of a twentieth of their range."""
    low, high = min(values), max(values)
    step = 10.0 ** math.floor(math.log10(high - low or 1e-3)) / 2
    return step * math.floor(low / step), step * math.ceil(high / step)


def _end(largest: float) -> float:
    """End of an axis that holds it: steps of a tenth, so that it does not change with every sample."""
    step = 10.0 ** math.floor(math.log10(largest or 1.0)) / 2
    return step * math.ceil(1.02 * (largest or 1.0) / step)


def _options(
    x: Shown,
    curves: Sequence[Curve],
    points: Sequence[Points],
    unit: str,
    logarithmic: bool,
    marks: Sequence[Mark],
    ends: Ends | None,
    empty: str,
) -> dict[str, Any]:
    rows = max((curve.row for curve in curves), default=0) + 1
    nothing = not any(len(one) for one in points)
    labels = {**_TEXT, "hideOverlap": True, "showMinLabel": ends is not None, "showMaxLabel": False}
    across = {
        "type": "log" if logarithmic else "value",
        "nameLocation": "middle",
        "nameGap": 24,
        "min": "dataMin" if ends is None else ends[0][0],
        "max": "dataMax" if ends is None else ends[0][1],
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
        # labels below the last one only
        part = 86.0 / rows
        grids.append(
            {
                "left": 58,
                "right": 18,
                "top": 22 if alone else f"{6 + row * part:.1f}%",
                **({"bottom": 42} if alone else {"height": f"{part - 7:.1f}%"}),
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
                "type": "log" if logarithmic else "value",
                "gridIndex": row,
                "scale": True,
                "name": shown.label,
                "nameTextStyle": {**_TEXT, "align": "left", "padding": [0, 0, 0, -50]},
                "nameGap": 8,
                "min": None if ends is None else ends[1][0],
                "max": None if ends is None else ends[1][1],
                # where rows lie close the ends of one meet those of the next
                "axisLabel": {**_TEXT, "hideOverlap": True, "showMinLabel": alone, "showMaxLabel": alone},
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
    named = ends is None and len(names) > 1
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
        "graphic": [
            {
                "type": "text",
                "left": "center",
                "top": "middle",
                "silent": True,
                "style": {"text": empty if nothing else "", "fill": "var(--dim)", "fontSize": 15},
            }
        ],
    }


_BOX = {"backgroundColor": "var(--raised)", "color": "var(--ink)"}


def _series(curve: Curve, points: Points, unit: str) -> list[dict[str, Any]]:
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
        "lineStyle": {
            "color": colour,
            "width": 1.5,
            "type": "dashed" if curve.style == "dashed" else "solid",
        },
        "itemStyle": {"color": colour},
        "tooltip": {":valueFormatter": _number(shown.unit)},
    }
    if curve.style == "points":
        return [{**common, "type": "scatter", "symbol": "circle", "symbolSize": 5, "data": list(points)}]
    if curve.style == "bars":
        return [{**common, "type": "bar", "barCategoryGap": "10%", "data": list(points)}]
    if curve.style == "intervals":
        ends: list[Sequence[float | None]] = []
        for x, y, u in points:
            ends += [(x, _plus(y, u, -1)), (x, _plus(y, u, 1)), (None, None)]
        middles = [(x, y) for x, y, _ in points]
        return [
            {**common, "data": ends, "tooltip": {"show": False}},
            {**common, "type": "scatter", "symbol": "circle", "symbolSize": 7, "data": middles},
        ]
    if curve.style == "band":
        edge = {
            **common,
            "stack": f"{curve.key}{curve.row}",
            "stackStrategy": "all",
            "tooltip": {"show": False},
        }
        edge["lineStyle"] = {"opacity": 0}
        low = [(x, _plus(y, u, -1)) for x, y, u in points]
        wide = [(x, 2 * (u or 0.0)) for x, _, u in points]
        return [
            {**edge, "data": low},
            {**edge, "data": wide, "areaStyle": {"color": colour, "opacity": 0.3}},
            {**common, "data": [(x, y) for x, y, _ in points]},
        ]
    return [{**common, "data": list(points)}]


def _plus(y: float | None, u: float | None, sign: int) -> float | None:
    return None if y is None else y + sign * (u or 0.0)


def _number(unit: str) -> str:
    """A function of the page that writes a number with its unit."""
    return f"v => window.rigNumber(v, {json.dumps(unit)})"


def _buttons(number: int, title: str) -> str:
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


SCRIPT = r"""
window.rigNumber = (value, unit) => {
  if (Array.isArray(value)) value = value[value.length - 1];
  if (value == null || !isFinite(value)) return '–';
  const number = Number(Number(value).toPrecision(6)).toString().replace('-', '−');
  return unit ? number + ' ' + unit : number;
};
(() => {
  const ends = (chart, axis, row) => chart.getModel().getComponent(axis, row).axis.scale.getExtent();
  const keep = (url, name) => Object.assign(document.createElement('a'), {href: url, download: name}).click();
  const cell = text => /[",\n]/.test(text) ? '"' + String(text).replaceAll('"', '""') + '"' : text;
  window.rigRows = chart => {
    // what is seen: the curves between the ends of the axes as they are zoomed
    const shown = chart.getOption(), rows = [['curve', 'x', 'x value', 'y', 'y value']];
    for (const one of shown.series) {
      const row = one.xAxisIndex || 0, [low, high] = ends(chart, 'xAxis', row);
      const [under, over] = ends(chart, 'yAxis', row);
      if (one.tooltip && one.tooltip.show === false) continue;
      for (const point of one.data || []) {
        if (point[0] == null || point[0] < low || point[0] > high) continue;
        if (point[1] == null || point[1] < under || point[1] > over) continue;
        rows.push([one.name, shown.xAxis.at(-1).name, point[0], shown.yAxis[row].name, point[1]]);
      }
    }
    return rows;
  };
  window.rigPicture = element => {
    const svg = element.querySelector('svg').cloneNode(true), style = getComputedStyle(element);
    const {width, height} = element.getBoundingClientRect();
    svg.setAttribute('width', width); svg.setAttribute('height', height);
    const text = new XMLSerializer().serializeToString(svg)
      .replace(/var\((--[\w-]+)\)/g, (_, name) => style.getPropertyValue(name).trim());
    return new Promise((done, failed) => {
      const image = new Image(), canvas = document.createElement('canvas');
      canvas.width = 2 * width; canvas.height = 2 * height;
      image.onload = () => {
        const to = canvas.getContext('2d');
        to.fillStyle = style.getPropertyValue('--card'); to.fillRect(0, 0, canvas.width, canvas.height);
        to.drawImage(image, 0, 0, canvas.width, canvas.height);
        done(canvas.toDataURL('image/png'));
      };
      image.onerror = failed;
      image.src = 'data:image/svg+xml;charset=utf-8,' + encodeURIComponent(text);
    });
  };
  document.addEventListener('click', async event => {
    const button = event.target.closest('[data-chart]');
    if (!button) return;
    const component = getElement(Number(button.dataset.chart)), chart = component && component.chart;
    // one that was not seen yet is not drawn yet
    if (!chart) return;
    const name = component.$el.getAttribute('aria-label').replace(/[^\w]+/g, '-');
    if (button.dataset.do === 'png') keep(await window.rigPicture(component.$el), name + '.png');
    if (button.dataset.do === 'csv') {
      const text = window.rigRows(chart).map(row => row.map(cell).join(',')).join('\n') + '\n';
      keep(URL.createObjectURL(new Blob([text], {type: 'text/csv'})), name + '.csv');
    }
    const zoom = chart.getOption().dataZoom[0], middle = (zoom.start + zoom.end) / 2;
    const half = (zoom.end - zoom.start) / 2 * {in: 0.5, out: 2}[button.dataset.do];
    if (button.dataset.do === 'all')
      for (const dataZoomIndex of [0, 1])
        chart.dispatchAction({type: 'dataZoom', dataZoomIndex, start: 0, end: 100});
    else if (half) chart.dispatchAction({type: 'dataZoom', dataZoomIndex: 0,
      start: Math.max(0, middle - half), end: Math.min(100, middle + half)});
  });
})();
"""
"""What the buttons of a chart do, and how a number is written with its unit."""
