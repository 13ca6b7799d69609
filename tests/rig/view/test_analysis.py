"""The analysing layout of real records, and the advice in the balancing layout."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from processing.deflections import DeflectionUnit
from processing.units import ARCSEC_RAD
from rig.instrument import advice_for, complete
from rig.settings import load_configuration
from rig.view.analysis import analysis_curves, report_text, run_analysis
from rig.view.show import show_record
from tests.rig.view.replay_record import CONFIG, WITHOUT_FIT, make_record
from tests.rig.view.rrd_contents import column, entities, measured, scalars, static_values

PANELS = {"decay", "residuals", "period", "period_residuals"}


def test_every_panel_has_its_curves_from_the_results_beside_the_record(measured_series: Path) -> None:
    run = run_analysis(measured_series / "run-1.mcap")
    curves = analysis_curves(run)
    assert {curve.panel for curve in curves} == PANELS
    by_name = {(curve.panel, curve.name): curve for curve in curves}
    measured, exact = by_name["decay", "measured"], by_name["decay", "exact fit"]
    residual = by_name["residuals", "exact fit"]
    np.testing.assert_allclose(residual.y, measured.y - exact.y, atol=1e-9)
    assert measured.u_y is not None
    # a good fit: nearly all residuals within four of their uncertainties
    assert np.mean(np.abs(residual.y) < 4 * measured.u_y) > 0.95
    text = report_text(run)
    assert text.startswith("## run-1")
    assert re.search(rf"^{run.half_cycles} half-cycles, [\d.]+ to [\d.]+ arcsec$", text, re.MULTILINE)
    assert f"| γ / MPa | {run['gamma'].text} |" in text


def test_a_record_without_results_is_fitted(tmp_path: Path) -> None:
    rrd = tmp_path / "fitted.rrd"
    show_record(make_record(tmp_path / "alone.mcap", 100.0), rrd=rrd, layout="analysing")
    drawn = entities(rrd)
    for panel in PANELS:
        assert f"/analysis/{panel}/axes/grid" in drawn, panel
    assert "/analysis/report" in drawn
    assert sorted(path.name for path in tmp_path.iterdir()) == ["alone.mcap", "fitted.rrd"]


def test_a_run_too_short_for_a_fit_shows_its_data_and_says_why(tmp_path: Path) -> None:
    run = run_analysis(make_record(tmp_path / "short.mcap", 15.0))
    assert [(curve.panel, curve.name) for curve in analysis_curves(run)] == [("decay", "measured")]
    assert "no fit: " in report_text(run)


def test_advice_names_what_is_out_of_limits_and_reaches_the_view_of_a_record(tmp_path: Path) -> None:
    record, rrd = make_record(tmp_path / "run.mcap", 15.0), tmp_path / "shown.rrd"
    show_record(record, rrd=rrd, layout="balancing")
    assert "balanced" in str(column(rrd, "/advice", "TextDocument:text"))
    with RecordReader(record) as reader:
        balance = reader.balances()[-1]
    config = complete(load_configuration(CONFIG))
    tilted = replace(balance, rest_x=40 * ARCSEC_RAD, line_angle_rad=math.radians(2.0))
    text = advice_for(config, tilted)
    assert text.startswith("**")
    assert "- rest position X +40" in text
    assert "mass centre too far towards +X" in text
    assert "- angle of the line +2" in text
    assert "rest position Y" not in text.split("\n", 1)[1]
    assert advice_for(config, replace(tilted, unit=DeflectionUnit.PX)) == ""
    assert advice_for(config, replace(tilted, rest_x=math.nan)) == ""


def test_a_record_without_a_calibration_is_shown_in_px(tmp_path: Path) -> None:
    rrd, path = tmp_path / "px.rrd", tmp_path / "px.mcap"
    make_record(path, 22.0, calibrated=False, overrides=WITHOUT_FIT)
    with RecordReader(path) as reader:
        names = reader.table("/balance").dtype.names or ()
        balances, expected = reader.balances(), reader.deflections().y
    assert len(balances) > 3
    # what is in rad without a lever, too, is the angle of the line
    assert all("line_angle" in name or "rotation" in name for name in names if "rad" in name)
    assert not any("arcsec" in name for name in names)
    show_record(path, rrd=rrd, layout="balancing")
    tables = str(column(rrd, "/balance_table", "TextDocument:text"))
    assert "| rest X / px |" in tables
    assert "| drift Y / (px/min) |" in tables
    assert "arcsec" not in tables
    assert "rad" not in tables
    assert measured(rrd, "/balance/rest_x")[1] == pytest.approx([b.rest_x for b in balances])
    assert static_values(rrd, "/balance/rest_x", "Measurements:names") == ["rest X / px"]
    assert column(rrd, "/advice", "TextDocument:text")[1] == []
    # without a lever deflections are px, and are shown as they are
    np.testing.assert_array_equal(scalars(rrd, "/deflection/y")[1], expected)
    assert np.nanmax(np.abs(expected)) > 100.0
    assert static_values(rrd, "/deflection/y", "SeriesLines:names") == ["Y / px"]
