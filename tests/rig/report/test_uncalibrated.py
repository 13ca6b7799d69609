"""Report and results of a record without calibration, and what is said of a configuration."""

import json
import math
import shutil
from pathlib import Path

import pytest

from rig.analysis import analyse_record, session_results
from rig.analysis.results_file import encoded
from rig.report.session_report import make_report
from rig.report.source import configuration_texts
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, SAMPLES, rig

RECORD = SAMPLES / "uncalibrated" / "run-1.mcap"


@pytest.mark.usefixtures("figures")
def test_without_calibration_the_report_is_in_pixels_and_says_so(tmp_path: Path) -> None:
    folder = shutil.copytree(RECORD.parent, tmp_path / "px")
    page = make_report(folder).read_text(encoding="utf-8")
    assert "No fit: the record has no calibration (no [lever]): amplitudes are in px" in page
    assert "20 half-cycles from 100.00 to 68.39 px" in page
    assert "log decrement 0.04" in page
    assert "<summary>The record and its circumstances</summary>" in page
    files = folder / "report" / "run-1"
    made = {name: (files / f"{name}.svg").exists() for name in ("fig12-decay", "damping", "fig13-period")}
    assert made == {"fig12-decay": True, "damping": True, "fig13-period": False}


def test_results_of_a_record_without_calibration_call_px_px(tmp_path: Path) -> None:
    run = encoded(session_results([analyse_record(RECORD)], RECORD.parent))["runs"][0]
    rows = {row["quantity"]: row for row in run["table"]}
    ends = rows["initial_amplitude"], rows["final_amplitude"]
    assert [run["amplitude_unit"], *(row["unit"] for row in ends)] == ["px"] * 3
    assert [row["value"] for row in ends] == pytest.approx([100.0, 68.39], abs=0.005)
    assert rows["mean_period_s"]["value"] == pytest.approx(4.0)
    assert rows["log_decrement"]["value"] == pytest.approx(0.04, rel=1e-6)
    assert rows["quality_factor"]["value"] == pytest.approx(math.pi / 0.04, rel=1e-6)
    assert run["damping"]["linear"]["value"] == pytest.approx(0.01, rel=1e-3)
    printed = rig("fit", RECORD, "-o", tmp_path / "fit").stdout
    assert "period 4.0" in printed
    assert "log decrement 0.04" in printed


@pytest.mark.parametrize("simulated", [True, False])
def test_a_real_run_shows_nothing_of_the_simulated_rig(simulated: bool) -> None:
    tree = json.loads(load_configuration(CONFIGS / "demo.toml").model_dump_json())
    shown = configuration_texts(tree, simulated=simulated)
    assert any(key.startswith("simulation.") for key in shown) is simulated
    assert shown["camera.driver"] == "simulated"
