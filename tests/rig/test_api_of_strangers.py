"""`import rig` with what a stranger's script hands over: taken as meant, or refused in one line."""

from pathlib import Path

import numpy as np
import pytest

import rig
from tests.rig.command_line import SAMPLES

RECORD = SAMPLES / "uncalibrated" / "run-1.mcap"


def test_a_run_counts_once() -> None:
    """One that was named twice was two runs, and its uncertainty too small by the square root of two."""
    with pytest.raises(rig.RigError, match=r"holds the run of .*, which counts once in a series"):
        rig.fit([RECORD, rig.open_record(RECORD)])
    with pytest.raises(rig.RigError, match="nothing is named"):
        rig.fit([])


def test_numbers_of_numpy_are_numbers() -> None:
    found = rig.fit(RECORD.parent, {"fit.robust": np.bool_(True), "fit.u_ageing": np.float32(0.25)})
    assert found.runs[0].settings["robust"] is True
    assert found.runs[0].settings["u_ageing"] == 0.25


def test_columns_are_named_as_a_text_or_a_number_and_tables_by_their_file(tmp_path: Path) -> None:
    time_s = 0.05 * np.arange(600)
    table = np.column_stack([time_s, 10.0 * np.exp(-0.01 * time_s) * np.cos(2.5 * time_s)])
    table[:, 1] += 0.01 * np.random.default_rng(1).standard_normal(len(table))
    np.savetxt(tmp_path / "decay.csv", table, delimiter=",", header="time_s,x", comments="")
    periods = {
        rig.fit_table(tmp_path / "decay.csv", "mm", time=time, positions=positions)["mean_period_s"].value
        for time, positions in (
            (None, ()),
            ("time_s", "x"),
            (1, 2),
            (1, [2]),
            ("1", ["2"]),
        )
    }
    assert len(periods) == 1


def test_a_law_that_is_no_function_is_refused() -> None:
    with pytest.raises(rig.RigError, match="law: a function of the angle is needed, not 'none'"):
        rig.fit(RECORD, law="none")  # type: ignore[arg-type]


def test_results_are_read_and_written_by_a_text_too(tmp_path: Path) -> None:
    found = rig.read_results(str(SAMPLES / "first"))
    rig.write_results(str(tmp_path / "results.json"), found)
    with pytest.raises(rig.RigError, match="exists already and is not overwritten"):
        rig.write_results(str(tmp_path / "results.json"), found)


def test_what_is_no_run_has_no_curves() -> None:
    with pytest.raises(rig.RigError, match=r"results.runs\[0\]\), not a SessionResults"):
        rig.curves(rig.read_results(SAMPLES / "first"))  # type: ignore[arg-type]


def test_what_is_no_results_is_not_written_as_such(tmp_path: Path) -> None:
    """A file of it was written, which nothing could read again."""
    path = tmp_path / "results.json"
    for given in (rig.read_results(SAMPLES / "first").runs[0], {"a": 1}, None):
        with pytest.raises(rig.RigError, match=r"results: what rig\.fit or rig\.fit_table returned"):
            rig.write_results(path, given)  # type: ignore[arg-type]
    assert not path.exists()


def test_a_table_that_runs_backwards_is_said_to_be_no_decay(tmp_path: Path) -> None:
    time_s = 0.05 * np.arange(1200)
    swing = 10.0 * np.exp(0.01 * time_s) * np.cos(2.5 * time_s)
    swing += 0.01 * np.random.default_rng(2).standard_normal(len(swing))
    table = np.column_stack([time_s, swing])
    np.savetxt(tmp_path / "back.csv", table, delimiter=",", header="time_s,x_mm", comments="")
    found = rig.fit_table(tmp_path / "back.csv", "mm")
    assert "quality_factor" not in found.rows
    assert any("is no free decay; is time reversed" in warning for warning in found.runs[0].warnings)
