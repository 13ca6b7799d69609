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
_CHARTS: Mapping[str, tuple[str, Sequence[Curve]]] = {
    "decay": (
        "elapsed_s",
        (
            Curve("amplitude", name="measured", style="points"),
            Curve("amplitude", name="fit", colour="second"),
            Curve("amplitude_residual_in_u", style="points", row=1),
        ),
    ),
    "period": (
        "elapsed_s",
        (
            Curve("period_s", name="measured", style="points"),
            Curve("period_s", name="fit", colour="second"),
            Curve("period_residual_in_u", style="points", row=1),
        ),
    ),
    "X and Y": ("elapsed_s", (Curve("deflection_x", colour="second"), Curve("deflection_y", row=1))),
    "parameters": ("elapsed_s", ()),
    "spectrum": (
        "frequency_hz",
        (
            Curve("density_rad_per_rthz", name="X", colour="second"),
            Curve("density_rad_per_rthz", name="Y", style="line"),
        ),
    ),
    "ground": ("frequency_hz", ()),
}
_MOST_PARAMETERS = 3
_SPECTRA = ("spectrum", "ground")
_LEFT = (Curve("left_density_rad_per_rthz"),)
_GROUND = (
    Curve("ground_m_per_s2_rthz", name="at most the ground"),
    Curve("ground_m_per_s2_rthz", name="quietest sites (NLNM)", style="dashed", colour="dim"),
    Curve("ground_m_per_s2_rthz", name="noisiest (NHNM)", style="dashed", colour="dim"),
)


class RunCharts:
    """A choice, and the chart that is chosen; built where it is made."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._charts: dict[str, Chart] = {}
        self._choice = at_once(ui.toggle(list(_CHARTS), value="decay", on_change=self._choose))
        self._choice.props('dense no-caps aria-label="which chart"')
        for name, (x, curves) in _CHARTS.items():
            self._charts[name] = Chart(name, x, curves, logarithmic=name in _SPECTRA)
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
        history = await run.io_bound(following.history, spectra=name in _SPECTRA)
        if not history:
            return
        chart, marks = self._charts[name], _marks(following.events, str(following.news.get("run") or ""))
        no_fit = first_fit(following.news.get("state") or {})
        if name in ("decay", "period"):
            kind = "amplitude" if name == "decay" else "period"
            at = 1 if name == "decay" else 3
            measured = [(one[0], one[at]) for one in history["swings"]]
            fit = history["fit"]
            left = fit.get(f"{kind}_residual", [])
            chart.show([measured, fit.get(kind, []), left], unit, marks=marks, below="" if left else no_fit)
        elif name == "X and Y":
            chart.show([history["x"], history["y"]], unit, marks=marks)
        elif name == "parameters":
            curves, points = _parameters(history["estimates"])
            chart.declare(curves)
            chart.show(points, unit, marks=marks, empty=no_fit)
        elif name == "ground":
            found = history["ground"]
            kinds = ("acceleration", "low", "high") if found["acceleration"] else ("left",)
            chart.declare(_LEFT if kinds == ("left",) else _GROUND)
            points = [list(zip(found["f"], found[one], strict=True)) for one in kinds]
            chart.show(points, unit, empty="it takes twenty periods of the swing")
        else:
            found = history["spectrum"]
            chart.show([list(zip(found["f"], found[one], strict=True)) for one in "xy"], unit)


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
