"""What a session hands over: the result with its whole uncertainty, what limits it, what to do next."""

import json
import shutil
from contextlib import closing
from pathlib import Path

import pytest

from processing.errors import ConfigurationError
from rig.analysis import read_results
from rig.measure import RunState, session_summary
from rig.measure.session_file import SessionFile
from tests.rig.command_line import SAMPLES


def test_a_result_with_what_limits_it_and_what_to_do() -> None:
    found = session_summary(SAMPLES / "first")
    assert found.ended is RunState.COMPLETE
    assert found.headline.startswith("b = 0.0300 ± 0.0042")
    assert found.u_covers == "the whole budget, swings and apparatus"
    assert [one.name for one in found.limits] == ["ageing of the friction", "half-cycles"]
    assert sum(one.share for one in found.limits) == pytest.approx(1.0, abs=0.05)
    assert found.next_steps == ["wait until the contact has settled, or state its history"]
    assert any("dropped frames" in one for one in found.remarks)


def test_a_run_that_was_stopped_too_early_hides_no_result_before_it(tmp_path: Path) -> None:
    folder = tmp_path / "two"
    shutil.copytree(SAMPLES / "first", folder)
    results = json.loads((folder / "results.json").read_text("utf-8"))
    results["runs"].append({**results["runs"][-1], "record": "run-2.mcap", "problem": "4 usable half-cycles"})
    (folder / "results.json").write_text(json.dumps(results), "utf-8")
    found = session_summary(folder)
    assert found.headline == session_summary(SAMPLES / "first").headline
    assert "no fit of run-2.mcap: 4 usable half-cycles" in found.remarks


def test_all_results_of_a_series_are_those_of_the_series(measured_series: Path) -> None:
    """Below the headline of the series stood the parameters of its last run."""
    found, results = session_summary(measured_series), read_results(measured_series)
    assert results.series is not None
    assert [text for _, text in found.other_results] == [row.text for row in results.series.table]


def test_a_session_that_was_killed_is_to_be_resumed_and_what_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no session"):
        session_summary(tmp_path)
    with closing(SessionFile.create(tmp_path, tmp_path / "rig.toml", 2, {})) as file:
        file.note(1, "run-1.mcap", RunState.RECORDING)
    found = session_summary(tmp_path)
    assert found.ended is RunState.INTERRUPTED
    assert found.next_steps[0] == "measure the missing runs: Runs, Resume"
    assert (found.headline, found.report) == ("", None)
