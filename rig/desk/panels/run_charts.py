"""The charts of a running session: one of them is seen, as it is chosen, since the beginning of the run."""

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import run, ui

from rig.desk.charts import Chart, Curve, Mark, Points
from rig.desk.desk import Desk
from rig.desk.panels.run_words import first_fit
from rig.desk.tab import Tab, at_once
from rig.presentation import quantity

_EVERY_S = 1.0
_KEYS = {"decay": "amplitude", "period": "period_s"}
_MOST_PARAMETERS = 3


def _with_fit(key: str) -> tuple[Curve, ...]:
    """Curves of a quantity, of its fit, and of what the fit leaves over."""
    left = f"{key.removesuffix('_s')}_residual_in_u"
    return (
        Curve(key, name="measured", style="points"),
        Curve(key, name="fit", colour="second"),
        Curve(left, style="points", row=1),
    )


class RunCharts:
    """A choice, and the chart that is chosen; built where it is made."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._charts: dict[str, Chart] = {}
        self._choice = at_once(ui.toggle([*_KEYS, "parameters"], value="decay", on_change=self._choose))
        self._choice.props('dense no-caps aria-label="which chart"')
        for name, key in _KEYS.items():
            self._charts[name] = Chart(name, "elapsed_s", _with_fit(key))
        self._charts["parameters"] = Chart("parameters", "elapsed_s", ())
        self._choose()
        tab.every(_EVERY_S, self._refresh)

    def _choose(self) -> None:
        for name, chart in self._charts.items():
            chart.frame.set_visibility(name == self._choice.value)

    async def _refresh(self) -> None:
        following = self._desk.following
        if not following.running:
            return
        unit, name = str(following.news.get("unit") or "arcsec"), str(self._choice.value)
        history = await run.io_bound(following.history)
        if not history:
            return
        chart, marks = self._charts[name], _marks(following.events, str(following.news.get("run") or ""))
        no_fit = first_fit(following.news.get("state") or {})
        if name == "parameters":
            curves, points = _parameters(history["estimates"])
            chart.declare(curves)
            chart.show(points, unit, marks=marks, empty=no_fit)
            return
        kind = _KEYS[name].removesuffix("_s")
        fit = history["fit"]
        left = fit[f"{kind}_residual"]
        chart.show(
            [history["swings"][kind], fit[kind], left], unit, marks=marks, below="" if left else no_fit
        )


def _parameters(estimates: Mapping[str, Sequence[Sequence[float]]]) -> tuple[list[Curve], list[Points]]:
    """A row with its band for each parameter, in the units shown."""
    keys = list(estimates)[:_MOST_PARAMETERS]
    curves = [Curve(key, style="band", row=row) for row, key in enumerate(keys)]
    points: list[Points] = [
        [(t, value * quantity(key).factor, u * quantity(key).factor) for t, value, u in estimates[key]]
        for key in keys
    ]
    return curves, points


def _marks(events: Sequence[Mapping[str, Any]], run: str) -> list[Mark]:
    """Events of the run at their times; those of an earlier one have another beginning."""
    return [
        (float(one["elapsed_s"]), f"{one['kind']}: {one['text']}")
        for one in tuple(events)
        if one["run"] == run and one["elapsed_s"] is not None and float(one["elapsed_s"]) >= 0
    ]
