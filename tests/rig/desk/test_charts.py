"""Charts: axes and units are the catalogue's."""

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from nicegui import Client
from nicegui.page import page

from rig.desk.charts import TRAJECTORY_CURVES, Chart, ChartCurve, chart_options, trajectory_reach
from rig.terminal import quantity


def test_axes_are_named_by_the_catalogue() -> None:
    found = chart_options(quantity("elapsed_s"), (ChartCurve("amplitude"),), [[(1.0, 2.0)]], "px")
    assert [found[axis]["name"] for axis in ("xAxis", "yAxis")] == [
        "t / s",
        "amplitude / px",
    ]


@pytest.mark.parametrize("high", [0.37, 9.4, 94.2, 95.0, 101.0, 128.0, 180.0])
def test_ends_of_a_trajectory_that_is_to_scale_are_labels(high: float) -> None:
    known = [(-0.1 * high, -high), (0.013 * high, 0.97 * high)]
    reach = trajectory_reach(known)
    assert high <= reach <= 2.1 * high
    found = chart_options(
        quantity("deflection_x"), TRAJECTORY_CURVES, [known, known[-1:]], "px", reach=reach, kind="square"
    )
    for axis in (found["xAxis"], found["yAxis"]):
        assert (axis["min"], axis["max"], axis["axisLabel"]["showMaxLabel"]) == (-reach, reach, True)
        assert 3 * axis["interval"] == pytest.approx(reach)
        assert float(f"{axis['interval']:.0e}") == pytest.approx(axis["interval"])


def test_a_trajectory_that_is_stretched_gives_the_ends_back() -> None:
    found = chart_options(
        quantity("deflection_x"), TRAJECTORY_CURVES, [[(1.0, 2.0)], []], "px", kind="square"
    )
    # the browser merges options: ends that are no longer named would stay
    for axis in (found["xAxis"], found["yAxis"]):
        assert (axis["min"], axis["max"], axis["interval"]) == (None, None, None)
        assert axis["scale"]


def test_words_in_an_empty_chart_go_when_it_is_filled() -> None:
    with Client(page("/")):
        chart = Chart("decay", "elapsed_s", (ChartCurve("amplitude"),))
        words = []
        for points in ([[]], [[(0.0, 2.0)]]):
            chart.show(points, empty="no fit yet")
            words.append(chart.element.options["graphic"]["style"]["text"])
    # the browser merges options: an element that is no longer named would stay
    assert words == ["no fit yet", ""]
