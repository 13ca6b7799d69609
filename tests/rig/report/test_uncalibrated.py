"""Reports of a record without calibration, of one without swings, and what is said of a configuration."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycle
from rig.analysis import analyse_record, session_results
from rig.analysis.results_file import write_results
from rig.instrument.provenance import CONFIGURATION_NAME
from rig.report.session_report import make_report
from rig.report.source import configuration_texts
from rig.settings import Configuration, load_configuration
from tests.rig.command_line import CONFIGS, rig

EPOCH_NS = 1_700_000_000_000_000_000
PERIOD_S = 4.0


def session_in_pixels(folder: Path, *, lost: bool) -> Path:
    """A record of 40 s in px with its results; `lost`: no frame has a spot, and so nothing swings."""
    folder.mkdir()
    time_s = np.arange(0, 40, 0.02)
    y = 100 * np.exp(-0.01 * time_s) * np.cos(2 * math.pi * time_s / PERIOD_S)
    y = np.full_like(y, math.nan) if lost else y
    x, u = 0.1 * y, np.where(np.isnan(y), math.nan, 0.01)
    if lost:
        spots = [Spot(*[math.nan] * 10, SpotFlag.LOST)] * len(y)
    else:
        spots = [Spot(32 + a, 120 + b, 0.01, 0.01, 3, 3, 0, 200, 8, 1, 0) for a, b in zip(x, y, strict=True)]
    record = folder / "run-1.mcap"
    attachments = {
        CONFIGURATION_NAME: Configuration(camera={"driver": "simulated"}).model_dump_json().encode()
    }
    with RecordWriter(record, EPOCH_NS, attachments=attachments, deflection_unit=DeflectionUnit.PX) as writer:
        times_ns = np.round(time_s * 1e9).astype(np.int64)
        numbers = list(range(len(y)))
        deflections = Deflections(times_ns, x, y, u, u, DeflectionUnit.PX)
        writer.write_spots(numbers, times_ns.tolist(), times_ns.tolist(), spots, deflections)
        image = np.full((240, 64), 8, dtype=np.uint8)
        image[218:223, 40:45] = 200
        writer.write_image(Frame(image, 0, 0, 0))
        for index in range(0 if lost else 20):
            amplitude = 100 * math.exp(-0.02 * index)
            turn_ns = round(0.5 * PERIOD_S * index * 1e9)
            writer.write_half_cycle(
                HalfCycle(index, turn_ns, 1e-4, amplitude, 0.01, 2.0, 1e-4, 0.0, 1 - 2 * (index % 2), 0)
            )
    write_results(folder / "results.json", session_results([analyse_record(record)], folder))
    return folder


@pytest.mark.usefixtures("figures")
def test_without_calibration_the_report_is_in_pixels_and_says_so(tmp_path: Path) -> None:
    page = make_report(session_in_pixels(tmp_path / "px", lost=False)).read_text(encoding="utf-8")
    assert "No fit: the record has no calibration (no [lever]): amplitudes are in px" in page
    assert "20 half-cycles from 100.00 to 68.39 px" in page
    files = tmp_path / "px" / "report" / "run-1"
    assert (files / "fig12-decay.svg").exists()
    assert not (files / "fig13-period.svg").exists()
    assert "log decrement 0.04" in page
    assert "<summary>The record and its circumstances</summary>" in page
    assert (files / "damping.svg").exists()


def test_results_of_a_record_without_calibration_call_px_px(tmp_path: Path) -> None:
    folder = session_in_pixels(tmp_path / "px", lost=False)
    run = json.loads((folder / "results.json").read_text(encoding="utf-8"))["runs"][0]
    rows = {row["quantity"]: row for row in run["table"]}
    assert (
        run["amplitude_unit"] == rows["initial_amplitude"]["unit"] == rows["final_amplitude"]["unit"] == "px"
    )
    assert rows["initial_amplitude"]["value"] == pytest.approx(100.0)
    assert rows["final_amplitude"]["value"] == pytest.approx(68.39, abs=0.005)
    assert rows["mean_period_s"]["value"] == pytest.approx(PERIOD_S)
    assert rows["log_decrement"]["value"] == pytest.approx(0.04, rel=1e-6)
    assert rows["quality_factor"]["value"] == pytest.approx(math.pi / 0.04, rel=1e-6)
    assert run["damping"]["linear"]["value"] == pytest.approx(0.01, rel=1e-3)
    printed = rig("fit", folder / "run-1.mcap", "-o", tmp_path / "fit").stdout
    assert "period 4.0" in printed
    assert "log decrement 0.04" in printed


def test_a_run_without_a_spot_is_reported_as_that(tmp_path: Path) -> None:
    page = make_report(session_in_pixels(tmp_path / "lost", lost=True)).read_text(encoding="utf-8")
    assert "0 half-cycles" in page
    assert not (tmp_path / "lost" / "report" / "run-1" / "fig12-decay.svg").exists()


@pytest.mark.parametrize("simulated", [True, False])
def test_a_real_run_shows_nothing_of_the_simulated_rig(simulated: bool) -> None:
    tree = json.loads(load_configuration(CONFIGS / "demo.toml").model_dump_json())
    shown = configuration_texts(tree, simulated=simulated)
    assert any(key.startswith("simulation.") for key in shown) is simulated
    assert shown["camera.driver"] == "simulated"
