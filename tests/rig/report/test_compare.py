"""`rig compare`: comparison of series, and with `--against` parameters over what surrounded the runs."""

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
import scipy

from processing.ambient import AmbientConditions
from processing.errors import ConfigurationError, RecordError
from processing.series import CombinedValue
from rig.analysis import Series, encoded
from rig.analysis.ambient import ambient_warnings
from rig.analysis.result_rows import series_rows
from rig.report.comparison import compare
from tests.processing.fit.decays import paper_pair
from tests.rig.command_line import rig


def session(folder: Path, changed: str = "", by: float = 0.0) -> Path:
    """A session of three runs whose combined parameters are stated; one moved by some uncertainties."""
    values = {"b": 3.7e-3, "p": 0.94, "c": 1.05e-8, "n": 0.092, "period0_s": 4.071, "gamma_pa": 2.9e7}
    exact: dict[str, Any] = {}
    for name, value in values.items():
        u = 1e-3 * value
        middle = value + by * u * (name == changed)
        exact[name] = {
            "value": middle, "standard_uncertainty": u,
            "degrees_of_freedom": 2, "within_runs": u, "between_runs": 0.0, "p_homogeneous": 0.5,
            "runs": [{"value": middle, "standard_uncertainty": 1.7 * u}] * 3,
        }  # fmt: skip
    folder.mkdir()
    combined = {name: CombinedValue(**{**item, "runs": ()}) for name, item in exact.items()}
    table = encoded(Series(table=series_rows(combined, {}, paper_pair("steel")[1])))["table"]
    series = {"exact": exact, "table": table}
    tree = {"schema": 1, "runs": [{"record": f"run-{k}.mcap"} for k in (1, 2, 3)], "series": series}
    (folder / "results.json").write_text(json.dumps(tree))
    return folder


def test_only_what_differs_is_said_to_differ(tmp_path: Path) -> None:
    """With two degrees of freedom each, 80 uncertainties are needed to be sure among six parameters."""
    folders = [session(tmp_path / "dry"), session(tmp_path / "wet", "gamma_pa", 80.0)]
    tree = json.loads((folders[0] / "results.json").read_text())
    (row,) = [row for row in tree["series"]["table"] if row["quantity"] == "surface_energy_table2_j_per_m2"]
    row |= {"value": 0.0289, "u_total": 0.0002}
    (folders[0] / "results.json").write_text(json.dumps(tree))
    values, differences = compare(folders, None)
    assert [row[1] for row in values.shown if row[0].startswith("σ")] == ["28.90 ± 0.20"]
    assert len(differences.shown) == 1
    assert differences.note.startswith("1 of 6 comparisons differ")
    # of runs that only limit it there is no mean that could differ
    tree["series"]["exact"]["gamma_pa"] |= {"value": None, "standard_uncertainty": None}
    limited = tmp_path / "limited"
    limited.mkdir()
    (limited / "results.json").write_text(json.dumps(tree))
    _, without = compare([limited, folders[1]], None)
    assert "gamma_pa" not in {str(row[2]) for row in without.rows}
    verdicts = {str(row[2]): str(row[-1]) for row in differences.rows}
    assert verdicts.pop("gamma_pa") == "differ"
    assert set(verdicts.values()) == {"no difference seen"}
    row = next(row for row in differences.rows if row[2] == "gamma_pa")
    assert float(row[3]) == pytest.approx(-80e-3 * 2.9e7)


def single(folder: Path, c: float) -> Path:
    """A session of one run, whose swings know c to one per cent."""
    names = {"b": 3.7e-3, "p": 0.94, "c": c, "n": 0.092, "period0_s": 4.071, "gamma_pa": 2.9e7}
    exact = {name: {"value": value, "standard_uncertainty": 0.01 * value} for name, value in names.items()}
    rows = [
        {"quantity": name, "value": item["value"], "u": item["standard_uncertainty"], "verdict": "determined"}
        for name, item in exact.items()
    ]
    run = {"record": "run-1.mcap", "table": rows, "fits": {"exact": exact | {"degrees_of_freedom": 500}}}
    folder.mkdir()
    (folder / "results.json").write_text(json.dumps({"schema": 1, "runs": [run]}))
    return folder


def test_two_single_runs_are_not_tested(tmp_path: Path) -> None:
    """Runs of one contact, 9 uncertainties of their swings apart, differed with a chance of 4e-17."""
    folders = [single(tmp_path / name, c) for name, c in (("a", 1.9e-7), ("b", 2.1e-7), ("c", 1.9e-7))]
    differences = compare(folders, None)[1]
    assert all(math.isnan(float(row[5])) for row in differences.rows)
    assert [row[0] for row in differences.shown] == ["a − b", "b − c"]
    assert all(row[3:] == ["–", "not tested"] for row in differences.shown)
    assert "18 comparisons are of two single runs, 2 of which differ by more than 3 u" in differences.note
    assert "Welch" not in differences.note


def test_a_single_run_scatters_as_those_of_the_series_it_is_compared_with(tmp_path: Path) -> None:
    """Between runs of the series c scatters by 3 %: a run 5 % away, with u 1 %, is no other contact."""
    many = session(tmp_path / "many")
    tree = json.loads((many / "results.json").read_text())
    tree["series"]["exact"]["c"] |= {"between_runs": 0.03 * 1.05e-8, "standard_uncertainty": 0.018 * 1.05e-8}
    (many / "results.json").write_text(json.dumps(tree))
    row = next(
        row for row in compare([many, single(tmp_path / "one", 1.1e-8)], None)[1].rows if row[2] == "c"
    )
    u = math.hypot(0.03, 0.018) * 1.05e-8
    assert float(row[4]) == pytest.approx(math.hypot(u, 0.01 * 1.1e-8), rel=1e-6)
    assert float(row[5]) == pytest.approx(2 * scipy.stats.t.sf(0.05e-8 / float(row[4]), 2), rel=1e-6)


@pytest.mark.usefixtures("figures")
def test_table_and_plot_of_three_series(tmp_path: Path) -> None:
    folders = [session(tmp_path / name) for name in ("a", "b", "c")]
    values, differences = compare(folders, tmp_path / "page.html")
    assert list(values.head) == ["", "a", "b", "c"]
    assert len(differences.rows) == 3 * 6
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert re.findall(r'src="(\w+:)', page) == ["data:"]
    assert (tmp_path / "page" / "comparison.svg").stat().st_size > 1000
    assert len((tmp_path / "page" / "values.csv").read_text().splitlines()) == 8


def test_a_simulated_series_is_called_so(tmp_path: Path) -> None:
    invented = session(tmp_path / "a")
    tree = json.loads((invented / "results.json").read_text())
    tree["runs"][0]["simulated"] = True
    (invented / "results.json").write_text(json.dumps(tree))
    values, differences = compare([invented, session(tmp_path / "b")], None)
    assert list(values.head) == ["", "a (SIMULATED)", "b"]
    assert differences.rows[0][0] == "a (SIMULATED)"


def test_a_series_fitted_with_a_seismometer_is_called_so(tmp_path: Path) -> None:
    folders = [session(tmp_path / name) for name in ("a", "b")]
    tree = json.loads((folders[0] / "results.json").read_text())
    tree["runs"][1]["seismometer"] = {"verdict": "used"}
    tree["runs"][2]["seismometer"] = {"verdict": "refused: it does not cover the run"}
    (folders[0] / "results.json").write_text(json.dumps(tree))
    values, _ = compare(folders, None)
    assert values.note.endswith("With a seismometer: a: 1 of 3 runs.")
    (folders[0] / "results.json").write_text(json.dumps(tree | {"runs": tree["runs"][:1]}))
    assert "seismometer" not in compare(folders, None)[0].note


def test_what_a_series_does_not_determine_is_a_bound(tmp_path: Path) -> None:
    """c is 1.05e-8 with an uncertainty of 0.9e-8: no number with digits, but less than something."""
    vague = session(tmp_path / "vague")
    tree = json.loads((vague / "results.json").read_text())
    (row,) = [row for row in tree["series"]["table"] if row["quantity"] == "c"]
    row |= {"value": None, "u_total": None, "upper": 4.95e-8, "verdict": "upper bound"}
    (vague / "results.json").write_text(json.dumps(tree))
    values, _ = compare([session(tmp_path / "clear"), vague], None)
    row = next(row for row, cells in zip(values.shown, values.rows, strict=True) if cells[0] == "c")
    assert "±" in row[1]
    assert row[2] == "< 5.0 × 10⁻⁸ (95 %)"


def test_a_measured_series_takes_part(measured_series: Path, tmp_path: Path) -> None:
    values, _ = compare([measured_series, session(tmp_path / "other")], None)
    row = next(row for row in values.rows if row[0] == "period0_s")
    tree = json.loads((measured_series / "results.json").read_text())
    assert row[1] == tree["series"]["exact"]["period0_s"]["value"]


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    one = session(tmp_path / "one")
    assert "a comparison needs two sessions or more" in rig("compare", one).stderr
    unfitted = tmp_path / "unfitted"
    unfitted.mkdir()
    tree = {"schema": 1, "runs": [{"record": "run-1.mcap", "problem": "no [pendulum]"}]}
    (unfitted / "results.json").write_text(json.dumps(tree))
    with pytest.raises(RecordError, match=r"no run of it was fitted \(no \[pendulum\]\)"):
        compare([one, unfitted], None)


def test_a_session_is_not_compared_with_itself(tmp_path: Path) -> None:
    """Two columns under one name would be one."""
    folder = session(tmp_path / "dry")
    with pytest.raises(ConfigurationError, match="named twice"):
        compare([folder, folder / ".." / "dry"], None)


def test_a_run_is_not_compared_with_itself(tmp_path: Path) -> None:
    """Two fits of one record are no two contacts, and their difference has no chance."""
    folders = [single(tmp_path / name, c) for name, c in (("a", 1.9e-7), ("b", 2.1e-7))]
    for folder in folders:
        tree = json.loads((folder / "results.json").read_text())
        tree["runs"][0]["sha256"] = "ab" * 32
        (folder / "results.json").write_text(json.dumps(tree))
    with pytest.raises(ConfigurationError, match=r"b: its run-1\.mcap is a run of a \(same hash\)"):
        compare(folders, None)


def test_decays_of_one_table_are_compared(tmp_path: Path) -> None:
    """The runs, parts and columns of a file have its hash; only what has the same rows is the same run."""
    places = {
        "all": {"run": "1", "began_s": 1.0, "ended_s": 90.0, "columns": ["x"]},
        "other-run": {"run": "2", "began_s": 1.0, "ended_s": 90.0, "columns": ["x"]},
        "late": {"run": "1", "began_s": 95.0, "ended_s": 150.0, "columns": ["x"]},
        "other-column": {"run": "1", "began_s": 1.0, "ended_s": 90.0, "columns": ["y"]},
        "again": {"run": "1", "began_s": 30.0, "ended_s": 60.0, "columns": ["x"]},
        "both-columns": {"run": "1", "began_s": 1.0, "ended_s": 90.0, "columns": ["x", "y"]},
    }
    for name, place in places.items():
        folder = single(tmp_path / name, 1.9e-7)
        tree = json.loads((folder / "results.json").read_text())
        tree["runs"][0] |= {"record": "two.csv", "sha256": "ab" * 32, "decay": place}
        (folder / "results.json").write_text(json.dumps(tree))
    apart = [tmp_path / name for name in ("all", "other-run", "late", "other-column")]
    values, _ = compare(apart, None)
    assert len(values.head) == 1 + len(apart)
    for name in ("again", "both-columns"):
        with pytest.raises(ConfigurationError, match=rf"{name}: its two\.csv is a run of all \(same hash\)"):
            compare([tmp_path / "all", tmp_path / name], None)


def at_humidities(folder: Path, percent: list[float | None]) -> Path:
    """A session whose c rises by 2e-10 with each per cent, with a scatter of 1e-11."""
    made = session(folder)
    tree = json.loads((made / "results.json").read_text())
    tree["runs"] = []
    for number, humidity in enumerate(percent):
        c = 1e-8 + 2e-10 * ((humidity or 0.0) - 40) + 1e-11 * (-1) ** number
        exact = {"c": {"value": c, "standard_uncertainty": 2e-11}}
        exact["b"] = {"value": 3.7e-3 + 1e-6 * (-1) ** number, "standard_uncertainty": 2e-6}
        run = {"record": f"run-{number + 1}.mcap", "fits": {"exact": exact}}
        tree["runs"].append(run | {"ambient": {"humidity_percent": humidity}})
    (made / "results.json").write_text(json.dumps(tree))
    return made


@pytest.mark.usefixtures("figures")
def test_what_depends_on_the_humidity_is_seen(tmp_path: Path) -> None:
    folders = [
        at_humidities(tmp_path / "a", [35.0, 40.0, 45.0]),
        at_humidities(tmp_path / "b", [50.0, 55.0, None]),
    ]
    *_, table = compare(folders, tmp_path / "page.html", "humidity")
    assert [row[:3] for row in table.rows][-1] == ["b", "run-2.mcap", 55.0]
    assert len(table.rows) == 5
    by_name = {row[0]: row for row in table.shown}
    assert float(by_name["c"][1].split()[0]) == pytest.approx(2.0, rel=0.05)
    assert by_name["c"][3] == "1/%"
    assert float(by_name["b"][4]) > 0.2
    assert (tmp_path / "page" / "against.svg").stat().st_size > 10_000
    assert (tmp_path / "page" / "against.csv").read_text().startswith("series,run,humidity_percent,b,u_b")
    # one session is enough, and two runs make no line
    values, table = compare([at_humidities(tmp_path / "c", [35.0, 45.0])], None, "humidity_percent")
    assert values.name == "values"
    assert table.shown == []
    assert "too few" in table.note


def test_a_humidity_stated_as_a_fraction_is_said(tmp_path: Path) -> None:
    table = compare([at_humidities(tmp_path / "a", [41.0, 0.45, 50.0, 58.0])], None, "humidity")[-1]
    assert "humidity_percent is 0.45 of a run-2.mcap, and 41 to 58 of the other runs" in table.note
    assert (
        "another unit"
        not in compare([at_humidities(tmp_path / "b", [5.0, 45, 58])], None, "humidity")[-1].note
    )
    (doubt,) = ambient_warnings(AmbientConditions(humidity_percent=0.45))
    assert doubt.endswith("state humidity_percent = 45")


def test_what_is_not_known_is_said(tmp_path: Path) -> None:
    folder = at_humidities(tmp_path / "a", [35.0, None])
    with pytest.raises(
        ConfigurationError, match="--against wind: there is no such quantity; there are age, dwell"
    ):
        compare([folder], None, "wind")
    with pytest.raises(RecordError, match="--against humidity_percent: known for 1 of 2 fitted runs"):
        compare([folder], None, "humidity")
    # no sensor reads how old a surface is
    with pytest.raises(RecordError, match=r"two are needed: state session\.surfaces_cleaned$"):
        compare([folder], None, "age")
