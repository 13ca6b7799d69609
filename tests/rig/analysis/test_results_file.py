"""results.json: written and read without loss, faults in one line, published schema."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from processing.errors import RecordError
from processing.fit import Change, ChangeKind, DiscrepancySize
from rig.analysis.results import RunResults, SessionResults
from rig.analysis.results_file import decoded, encoded, read_results, results_schema, write_results
from rig.analysis.run_values import StoredTurningPoints

SCHEMA_FILE = Path(__file__).resolve().parents[3] / "docs" / "results.schema.json"


def results_of(folder: Path) -> dict[str, Any]:
    tree: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return tree


def test_what_is_read_is_written_the_same(measured_series: Path, tmp_path: Path) -> None:
    found = read_results(measured_series)
    write_results(tmp_path / "results.json", found)
    text = (measured_series / "results.json").read_text()
    assert (tmp_path / "results.json").read_text() == text
    arrays = [line for line in text.splitlines() if line.strip().startswith('"time_s": [')]
    assert [line.rstrip(",")[-1] for line in arrays] == ["]", "]"], "each stands on one line"
    assert '"matrix": [\n' in text, "each row of a matrix stands on a line"
    run = found.runs[0]
    assert len(run.points) == run.half_cycles
    assert run.points.time_s[0] == 0.0
    assert np.all(run.points.u_amplitude > 0)
    stored = run.stored
    assert len(stored.left_out_time_s) == len(stored.left_out_amplitude) == len(stored.left_out_flags)
    assert np.all(stored.left_out_flags != 0)


def test_what_is_not_determined_is_null_in_arrays_too(tmp_path: Path) -> None:
    index, numbers = np.arange(5), np.array([0.0, math.nan, math.inf, -1e101, 1e99])
    stored = StoredTurningPoints(
        index=index, time_s=numbers, u_time_s=numbers, amplitude=numbers, u_amplitude=numbers
    )
    write_results(
        tmp_path / "results.json", SessionResults(runs=(RunResults(record="run", turning_points=stored),))
    )
    tree = results_of(tmp_path)["runs"][0]["turning_points"]
    assert tree["index"] == [0, 1, 2, 3, 4]
    assert tree["time_s"] == [0.0, None, None, None, 1e99]
    again = read_results(tmp_path).runs[0].stored
    assert np.isnan(again.u_amplitude).tolist() == [False, True, True, True, False]


def test_reading_results_loads_nothing_that_analyses(measured_series: Path) -> None:
    """`rig record info` took more than a second of processor time, most of it for this."""
    code = (
        "import sys, rig.analysis as face; from pathlib import Path; "
        f"run = face.read_results(Path({str(measured_series)!r})).runs[0]; "
        "assert face.main_result(run).text; print(*sys.modules); "
        "assert all(getattr(face, name) for name in face._LAZY)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"rig.settings", "rig.instrument", "rig.intake", "calibration"}.isdisjoint(loaded)
    assert {"rig.analysis.record_fit", "rig.analysis.series", "matplotlib"}.isdisjoint(loaded)


def test_null_says_not_determined_and_what_a_law_does_not_describe_is_stored(measured_series: Path) -> None:
    tree = results_of(measured_series)
    tree["runs"][0]["fits"]["exact"]["c"]["standard_uncertainty"] = None
    tree["runs"][0]["table"][0]["upper"] = None
    session = decoded(tree, measured_series)
    run = session.runs[0]
    assert math.isnan(run.fits["exact"].estimate("c").standard_uncertainty)
    assert math.isnan(run.table[0].upper)
    assert encoded(session) == tree
    change = Change(
        kind=ChangeKind.FRICTION, half_cycle=143, time_s=296.0, size=0.047, u_size=0.001, gain=445.0
    )
    discrepancy = DiscrepancySize(loss=0.04, against_law=278.0, u_inflation={"b": 10.4})
    fits = {**run.fits, "exact": replace(run.fits["exact"], changes=(change,), discrepancy=discrepancy)}
    written = replace(session, runs=(replace(run, fits=fits), *session.runs[1:]))
    again = decoded(json.loads(json.dumps(encoded(written))), measured_series).runs[0].fits["exact"]
    assert (again.changes, again.discrepancy) == ((change,), discrepancy)


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("runs", 0, "half_cycles"), "many", "runs 1: half_cycles = 'many': should be a whole number"),
        (
            ("runs", 0, "fits", "exact", "b"),
            {"value": 1.0},
            r"fits\.exact\.\S*\.standard_uncertainty: is missing",
        ),
        (("runs", 1, "fits", "exact", "b", "value"), [1], r"b\.value = \[1\]: should be a number"),
        (("runs", 0), 7, "runs 1 = 7: should be"),
        (("runs",), [], "names no runs"),
        (("schema",), 99, "is of schema 99; this version reads schema 1"),
    ],
)
def test_a_fault_is_one_line_that_names_file_key_and_remedy(
    measured_series: Path, tmp_path: Path, keys: tuple[str | int, ...], value: object, words: str
) -> None:
    tree = results_of(measured_series)
    place: Any = tree
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    (tmp_path / "results.json").write_text(json.dumps(tree))
    with pytest.raises(RecordError, match=words) as error:
        read_results(tmp_path)
    text = str(error.value)
    assert str(tmp_path / "results.json") in text
    assert "\n" not in text
    assert "pydantic" not in text


def test_the_published_schema_is_current_and_names_every_key_of_a_file(measured_series: Path) -> None:
    """`make schema` writes it again."""
    assert SCHEMA_FILE.read_text(encoding="utf-8") == results_schema()
    schema = json.loads(results_schema())
    run = schema["$defs"]["RunResults"]["properties"]
    assert set(results_of(measured_series)["runs"][0]) <= set(run)
    assert "chi2_per_dof" in schema["$defs"]["Fit"]["properties"]
    assert schema["$defs"]["Fit"]["additionalProperties"] == {"$ref": "#/$defs/Estimate"}
    assert schema["$defs"]["Estimate"]["required"] == ["value", "standard_uncertainty"]


def test_columns_of_different_lengths_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    points = {"index": [0, 1], "time_s": [0.0], "u_time_s": [], "amplitude": [], "u_amplitude": []}
    path.write_text(json.dumps({"schema": 1, "runs": [{"record": "run-1.mcap", "turning_points": points}]}))
    with pytest.raises(RecordError, match="columns of equal length"):
        read_results(path)
    path.write_text("[" * 100_000)
    with pytest.raises(RecordError, match="is not JSON"):
        read_results(path)
