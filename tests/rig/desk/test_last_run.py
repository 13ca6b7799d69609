"""What the list of sessions shows of the last run of each."""

import json
import shutil
from pathlib import Path

from rig.desk.sessions import SessionIndex, last_run, last_summary

SERIES = Path(__file__).resolve().parents[1] / "data" / "samples" / "series"


def test_the_last_run_has_its_numbers_with_their_whole_uncertainty() -> None:
    found = last_run(SERIES)
    assert found == {
        "sigma": "258 ± 24",
        "b": "0.0299 ± 0.0026",
        "c": "(9.38 ± 0.87) × 10⁻⁸",
        "balance": "go",
    }


def test_balance_is_judged_by_its_conditions_and_what_is_not_determined_is_no_number(tmp_path: Path) -> None:
    folder = shutil.copytree(SERIES, tmp_path / "series")
    results = json.loads((folder / "results.json").read_text("utf-8"))
    run = results["runs"][-1]
    for ok, lamp in ((True, "go"), (False, "no")):
        (plane,) = [one for one in run["conditions"] if one["name"] == "plane of swing"]
        plane["ok"] = ok
        # as results are written: what is not determined has no value
        run["table"][0] |= {"verdict": "upper bound", "value": None, "u": None, "u_total": None}
        (folder / "results.json").write_text(json.dumps(results), "utf-8")
        found = last_run(folder)
        assert (found["balance"], found["b"]) == (lamp, "upper bound")


def test_results_that_a_resumed_session_has_added_take_the_place_of_the_first(tmp_path: Path) -> None:
    """The list went on with results.json, and the summary was read again only when that file had changed."""
    folder = shutil.copytree(SERIES, tmp_path / "series")
    index = SessionIndex(tmp_path)
    index.look()
    first = last_summary(folder)
    results = json.loads((folder / "results.json").read_text("utf-8"))
    for run in results["runs"]:
        run["problem"] = "4 usable half-cycles"
    results["runs"][-1]["table"] = []
    (folder / "results-2.json").write_text(json.dumps(results), "utf-8")
    index.look()
    (row,) = index.rows(None)
    assert (row.b, last_run(folder)["b"]) == ("", "")
    assert last_summary(folder) != first


def test_a_session_without_results_has_nothing_to_show(tmp_path: Path) -> None:
    assert last_run(tmp_path) == {}
