"""`import rig` with what a stranger's script hands over: taken as meant, or refused in one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from tests.rig.command_line import SAMPLES

RECORD = SAMPLES / "uncalibrated" / "run-1.mcap"


class Frame:
    """What is gone through by the names of its columns, as a data frame is."""

    shape = (3, 2)

    def __iter__(self) -> Any:
        return iter(("t", "x"))


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (None, "source: paths, or what was opened, are needed, not None"),
        (3, "not a int"),
        (np.arange(9.0), "not a ndarray"),
        (Frame(), "not a Frame"),
        ([], "source: is empty; name at least one"),
        ([np.arange(3.0)], "source: a path is needed, not a ndarray; save what is in memory first"),
        ([RECORD, rig.open_record(RECORD)], "holds the run of .*, which counts once in a series"),
    ],
)
def test_what_is_no_record_is_refused(source: Any, said: str) -> None:
    """A run that was named twice was two runs, and its uncertainty too small by the square root of two."""
    with pytest.raises(rig.RigError, match=said):
        rig.fit(source)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["fit.robust=true"], "overrides: a mapping from keys to values is needed"),
        ("fit.robust=true", "overrides: a mapping"),
        ({"fit.robust=true\nfit.drag": 1}, "is no key of the configuration"),
        ({"fit.robust": np.ones(2)}, "fit.robust: a ndarray is no value of a configuration"),
        ({"fit.robust": Path("x")}, "is no value of a configuration"),
        ({"fit.u_ageing": np.float32("nan")}, "fit.u_ageing"),
    ],
)
def test_what_is_no_change_is_refused(changes: Any, said: str) -> None:
    with pytest.raises(rig.RigError, match=said):
        rig.fit(RECORD, changes)


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
            (np.int64(1), np.int32(2)),
        )
    }
    assert len(periods) == 1
    for given in (table, Frame()):
        with pytest.raises(rig.RigError, match=r"path: a path is needed, not a .*to_csv"):
            rig.fit_table(given, "mm")  # type: ignore[arg-type]


def test_a_law_that_is_no_function_is_refused() -> None:
    with pytest.raises(rig.RigError, match="law: a function of the angle is needed, not 'none'"):
        rig.fit(RECORD, law="none")  # type: ignore[arg-type]


def test_results_are_read_and_written_by_a_text_too(tmp_path: Path) -> None:
    found = rig.read_results(str(SAMPLES / "first"))
    rig.write_results(str(tmp_path / "results.json"), found)
    with pytest.raises(rig.RigError, match="exists already and is not overwritten"):
        rig.write_results(str(tmp_path / "results.json"), found)
    with pytest.raises(rig.RigError, match="sessions: is empty"):
        rig.campaign([])


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: rig.open_record(3), "path: a path is needed, not a int"),  # type: ignore[arg-type]
        (lambda: rig.open_session(np.ones(2)), "folder: a path is needed"),  # type: ignore[arg-type]
        (lambda: rig.figures(None), "source: a path is needed, not None"),  # type: ignore[arg-type]
        (lambda: rig.read_results(None), "source: a path is needed, not None"),  # type: ignore[arg-type]
        (lambda: rig.fit_film(np.zeros((3, 4, 5))), "path: a path is needed"),  # type: ignore[arg-type]
        (
            lambda: rig.fit_film("film", pixel=0.142),
            "pixel: a text such as '0.142 mm' is needed",
        ),  # type: ignore[arg-type]
        (lambda: rig.fit_film("film", configuration={}), "configuration: a path"),  # type: ignore[arg-type]
        (lambda: rig.campaign(["x"], {"parameters": ["b"]}), "stated: a path is needed"),  # type: ignore[arg-type]
        (lambda: rig.campaign(["x"], output=3), "output: a path is needed"),  # type: ignore[arg-type]
        (lambda: rig.fit_table("x.csv", 5), "unit: a text such as 'arcsec' is needed, not a int"),  # type: ignore[arg-type]
        (lambda: rig.fit_table("x.csv", "mm", time_unit=1), "time_unit: a text such as 'ms'"),  # type: ignore[arg-type]
        (lambda: rig.fit_table("x.csv", "mm", positions=2.0), "positions: names of columns, or numbers"),  # type: ignore[arg-type]
        (lambda: rig.fit_table("x.csv", "mm", positions=None), "positions: .* not None"),  # type: ignore[arg-type]
        (lambda: rig.fit_table("x.csv", "mm", time=True), "time: names of columns, or numbers from 1"),
        (
            lambda: rig.curves(rig.read_results(SAMPLES / "first")),
            r"results.runs\[0\]\), not a SessionResults",
        ),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_meant_is_refused_in_a_line(call: Any, said: str) -> None:
    with pytest.raises(rig.RigError, match=said) as found:
        call()
    assert "\n" not in str(found.value)


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
