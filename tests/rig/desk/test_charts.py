"""Charts: axes and units are the catalogue's; in a real browser a zoom stays."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from nicegui import Client
from nicegui.page import page

from acquisition.camera import Frame
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from rig.desk.charts import Chart, ChartCurve, chart_options, trajectory_ends
from rig.devices import OrderSocket, SessionNews
from rig.instrument import Block
from rig.presentation import quantity
from rig.settings import Configuration
from tests.rig.desk.desk_page import DeskProcess, Page

SPOT = Spot(16.0, 32.0, 0.01, 0.01, 2.0, 2.0, 0.0, 100.0, 4.0, 1.0, 0)
OF = "getElement(Number(document.querySelector('[aria-label=\"trajectory\"]').id.slice(1))).chart"


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


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_trajectory_is_drawn_and_a_zoom_outlives_new_points(
    shown: tuple[DeskProcess, Page], desk_output: Path
) -> None:
    _, page = shown
    session_news = SessionNews(Configuration(camera={"driver": "simulated"}))  # type: ignore[arg-type]
    session_news.begin_run("run 1", 255, None)
    frame = Frame(np.full((64, 32), 40, np.uint8), 1, 1, 1)
    y = np.linspace(-10.0, 10.0, 100)
    none = np.zeros_like(y)
    way = Deflections(np.arange(100) * 10**7, y, y, none, none, DeflectionUnit.PX)
    folder = desk_output / "of-charts"
    folder.mkdir(parents=True)
    page.key("3")
    with OrderSocket(folder, session_news, {}):
        session_news.look([frame], Block([SPOT], way, [], []))
        page.wait(f"{OF}.getOption().series[0].data.length > 90")
        page.ask(f"{OF}.dispatchAction({{type: 'dataZoom', dataZoomIndex: 0, start: 0, end: 75}})")
        page.wait(f"{OF}.getOption().dataZoom[0].end === 75")
        more = Deflections(way.times_ns + 10**9, 0.5 * y, y, none, none, DeflectionUnit.PX)
        session_news.look([frame], Block([SPOT], more, [], []))
        page.wait(f"{OF}.getOption().series[0].data.length > 190")
        assert page.ask(f"{OF}.getOption().dataZoom[0].end") == 75
        assert page.ask("rigNumber(-1.23456789, 'px')") == "−1.23457 px"
    page.wait("document.getElementById('amplitude').offsetParent === null")
