"""`rig archive refit`: sessions fitted again, whatever a record does, also by a cluster on the loopback."""

import json
import re
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from rig.archive import add_folders, query_runs, refit_runs
from rig.archive.updating import RefitTask, Work, _in_processes
from rig.view import analyse_replayed
from tests.rig.archive.deadly import Deadly, outcome_of
from tests.rig.command_line import SAMPLES, rig


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """An archive of one session: a whole run and one that was cut short."""
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    add_folders(tmp_path / "archive.duckdb", [tmp_path / "runs"])
    return tmp_path / "archive.duckdb"


def in_this_process(
    work: Work, tasks: Sequence[RefitTask], processes: int | None
) -> Iterator[tuple[RefitTask, str]]:
    """Starting processes takes seconds; what they do has a test of its own."""
    return ((task, work(task)) for task in tasks)


@pytest.mark.slow
def test_results_made_again_stand_beside_the_earlier_ones_and_are_listed(
    archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.archive.updating._in_processes", in_this_process)
    series = archive.parent / "runs" / "series"
    earlier = (series / "results.json").read_bytes()
    words = ("--where", "state = 'whole'", "--set", "fit.robust=true", "--law", "viscous")
    done = rig("archive", "refit", *words, "--archive", archive)
    assert (done.returncode, done.stdout) == (0, "1 sessions fitted again, 0 left as they were\n")
    assert (series / "results.json").read_bytes() == earlier
    tree = json.loads((series / "results-2.json").read_text())
    assert [run["record"] for run in tree["runs"]] == ["run-1.mcap", "run-2.mcap"]
    assert tree["runs"][0]["settings"]["robust"] is True
    assert "viscous" in json.dumps(tree["runs"][0]["laws"])
    columns = "run, b, results"
    listed = [
        (run["record"][:5], run["fits"]["exact"]["b"]["value"], "results-2.json") for run in tree["runs"]
    ]
    assert query_runs(archive, columns, "order by run")[1] == listed
    # the same that rig fit finds of a record
    done = rig("fit", series / "run-2.mcap", "--set", "fit.robust=true", "-o", archive.parent / "fit")
    assert done.returncode == 0, done.stderr
    (fitted,) = json.loads((archive.parent / "fit" / "results.json").read_text())["runs"]
    assert fitted["fits"] == tree["runs"][1]["fits"]


@pytest.mark.slow
def test_each_level_begins_further_back() -> None:
    record = SAMPLES / "series" / "run-1.mcap"
    spots, pixels = (analyse_replayed(record, retrack=again) for again in (False, True))
    assert spots.sha256 == pixels.sha256
    assert spots.half_cycles == pixels.half_cycles > 10
    b, b_again = (run.fits["exact"].estimate("b") for run in (spots, pixels))
    assert b.value == pytest.approx(b_again.value, abs=3 * b.standard_uncertainty)


def test_what_cannot_be_done_is_said_and_not_written(archive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.archive.updating._in_processes", in_this_process)
    refused = rig("archive", "refit", "--set", "fit.colour=red", "--archive", archive)
    assert refused.returncode == 2
    assert "fit.colour" in refused.stderr
    law = rig("archive", "refit", "--law", "wishful", "--archive", archive)
    assert "--law wishful: no such law; there are paper, masing, " in law.stderr
    both = rig("archive", "refit", "09dd", "--where", "true", "--archive", archive)
    assert "has no effect beside 09dd" in both.stderr
    record = archive.parent / "runs" / "series" / "run-1.mcap"
    record.write_bytes(record.read_bytes() + b"\0")
    changed = rig("archive", "refit", "--archive", archive)
    assert changed.returncode == 1
    assert "has changed since it was read" in changed.stderr
    assert not list(record.parent.glob("results-*.json"))


@pytest.mark.slow
def test_a_session_that_ends_its_process_costs_no_other(tmp_path: Path) -> None:
    names = ("a", "poison", "b", "once", "fault", "c")
    tasks: Any = [Deadly(tmp_path / name) for name in names]
    work: Any = outcome_of
    said = {task.folder.name: outcome for task, outcome in _in_processes(work, tasks, 2)}
    assert said == {
        **dict.fromkeys(("a", "b", "c", "once"), ""),
        "poison": "its process was ended, also when it ran alone",
        "fault": "failed: ValueError('of this one alone')",
    }


def test_a_cluster_that_is_not_there_is_said(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = rig("archive", "refit", "--cluster", "tcp://127.0.0.1:9", "--archive", archive)
    assert done.returncode == 2
    assert "no Dask scheduler answers there" in done.stderr or "needs distributed" in done.stderr
    assert refit_runs(archive, [], "b > 1e9", "swings") == 0
    assert capsys.readouterr().out == "0 sessions fitted again, 0 left as they were\n"


ROOT = Path(__file__).resolve().parents[3]
DOCUMENTS = (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"))


def test_every_documented_command_of_dask_names_the_loopback() -> None:
    pattern = re.compile(r"(?:`|^ {4})(dask (?:scheduler|worker)[^`\n]*)", re.MULTILINE)
    found = [command for path in DOCUMENTS for command in pattern.findall(path.read_text(encoding="utf-8"))]
    assert [command.split()[1] for command in found] == ["scheduler", "worker"]
    for command in found:
        assert "--host 127.0.0.1" in command, command
        assert "--dashboard-address 127.0.0.1:" in command, command


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_a_cluster_fits_sessions_again(archive: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="pip install 'optical-pendulum-rig[series]'")
    with distributed.LocalCluster(1, host="127.0.0.1", dashboard_address=None) as cluster:
        assert refit_runs(archive, [], "", "swings", cluster=cluster.scheduler_address) == 0
    assert (archive.parent / "runs" / "series" / "results-2.json").exists()
