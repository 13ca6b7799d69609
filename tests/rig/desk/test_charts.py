"""Charts: axes and units are the catalogue's."""

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from nicegui import Client
from nicegui.page import page

from rig.desk.charts import Chart, ChartCurve, chart_options, trajectory_ends
from rig.presentation import quantity


def test_axes_are_named_by_the_catalogue_and_a_band_is_as_wide_as_it_says() -> None:
    curves = (ChartCurve("amplitude"), ChartCurve("period_s", style="band", row=1))
    found = chart_options(
        quantity("elapsed_s"), curves, [[(0.0, 2.0)], [(0.0, 4.0, 0.5)]], "px", [], None, ""
    )
    assert [axis["name"] for axis in found["yAxis"]] == ["amplitude / px", "period / s"]
    low, wide = (one["data"] for one in found["series"][1:3])
    assert (low, wide) == ([(0.0, 3.5)], [(0.0, 1.0)])
    assert found["graphic"][0]["style"]["text"] == ""


def test_rows_below_each_other_have_the_same_time() -> None:
    curves = (ChartCurve("amplitude"), ChartCurve("period_s", row=1))
    points = [[(1.0, 2.0), (9.0, 1.0)], [(3.0, 4.0), (5.0, 4.0)]]
    found = chart_options(quantity("elapsed_s"), curves, points, "arcsec", [], None, "")
    assert [(axis["min"], axis["max"]) for axis in found["xAxis"]] == [(1.0, 9.0), (1.0, 9.0)]


@pytest.mark.parametrize("high", [0.37, 9.4, 94.2, 95.0, 101.0, 128.0, 180.0])
def test_ends_of_a_trajectory_are_labels(high: float) -> None:
    extents = (-0.1 * high, 0.013 * high), (-high, 0.97 * high)
    known = list(zip(*extents, strict=True))
    for stretched in (False, True):
        for axis, extent in zip(trajectory_ends(known, stretched=stretched), extents, strict=True):
            low, top, step = axis
            assert low <= extent[0] < extent[1] <= top
            assert low / step == pytest.approx(round(low / step), abs=1e-9)
            assert 3 <= round((top - low) / step) <= 7


def test_words_in_an_empty_row_go_when_it_is_filled() -> None:
    curves = (ChartCurve("amplitude"), ChartCurve("amplitude_residual_in_u", row=1))
    with Client(page("/")):
        chart = Chart("decay", "elapsed_s", curves)
        chart.show([[(0.0, 2.0)], []], below="no fit yet")
        words = [[one["style"]["text"] for one in chart.element.options["graphic"]]]
        chart.show([[(0.0, 2.0)], [(0.0, 1.0)]])
        words += [[one["style"]["text"] for one in chart.element.options["graphic"]]]
    # the browser merges options: an element that is no longer named would stay
    assert words == [["", "no fit yet"], ["", ""]]
