"""`rig archive refit`: records fitted again, once each, whatever a record does to its reader."""

import contextlib
import json
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from processing.errors import ConfigurationError
from rig.archive import add_sessions
from rig.archive.refits import Recipe, Task, code_identity, read_refit, refit
from rig.archive.refitting import on_cluster
from rig.archive.store import Archive
from rig.archive.workers import alone, in_processes
from rig.replay import analyse_replayed
from tests.rig.archive.deadly_work import deadly
from tests.rig.command_line import rig

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """An archive of one session: a whole run and one that was cut short."""
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    add_sessions(tmp_path / "archive", [tmp_path / "runs"])
    return tmp_path / "archive"


def in_this_process(
    work: Callable[[Task], str], tasks: Sequence[Task], processes: int
) -> Iterator[tuple[Task, str | None]]:
    """Starting processes takes seconds; what they do has a test of its own."""
    return ((task, work(task)) for task in tasks)


def done(archive: Path, *words: str | Path) -> str:
    """What refit prints."""
    found = rig("archive", "refit", *words, "--archive", archive)
    assert found.returncode == 0, found.stderr
    return found.stdout


@pytest.mark.slow
def test_results_made_again_are_kept_in_versions_and_listed(
    archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.archive.refitting.in_processes", in_this_process)
    whole = ("--where", "state = 'whole'")
    assert done(archive, *whole) == "1 runs fitted again, 0 known already, 0 left out, 0 in quarantine\n"
    assert done(archive, *whole) == "0 runs fitted again, 1 known already, 0 left out, 0 in quarantine\n"
    assert "1 runs fitted again" in done(archive, *whole, "--set", "fit.robust=true", "--law", "viscous")
    listed = rig("archive", "list", "order by made_utc", "--refits", "--format", "json", "--archive", archive)
    rows = json.loads(listed.stdout)
    assert [row["newest"] for row in rows] == [False, True]
    columns = ("--columns", "settings, laws, level, newest, b, sample, code", "--refits", "--format", "json")
    first, second = json.loads(
        rig("archive", "list", "order by made_utc", *columns, "--archive", archive).stdout
    )
    assert (first["settings"], second["settings"]) == ("", "fit.robust=true")
    assert (second["laws"], second["level"], second["newest"]) == ("viscous", "swings", True)
    assert second["b"] > 0
    assert second["sample"] == "steel ball on K8 glass, simulated"
    # merged, and with one file deleted, the same is said of the other
    store = Archive(archive)
    store.refits.merge(at_once=1)
    (older,) = [
        name for name in store.refits.names() if not read_refit(store.refits.path(name)).recipe.settings
    ]
    store.refits.path(older).unlink()
    (only,) = json.loads(rig("archive", "list", *columns, "--archive", archive).stdout)
    assert only == second


@pytest.mark.slow
def test_each_level_begins_further_back(archive: Path) -> None:
    record = archive.parent / "runs" / "series" / "run-1.mcap"
    spots, pixels = (analyse_replayed(record, retrack=again).results for again in (False, True))
    assert spots.sha256 == pixels.sha256
    assert spots.half_cycles == pixels.half_cycles > 10
    b, b_again = (run.fits["exact"].estimate("b") for run in (spots, pixels))
    assert b.value == pytest.approx(b_again.value, abs=3 * b.standard_uncertainty)


def test_what_cannot_be_done_is_said_and_not_stored(
    archive: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("rig.archive.refitting.in_processes", in_this_process)
    refused = rig("archive", "refit", "--set", "fit.colour=red", "--archive", archive)
    assert refused.returncode == 2
    assert "fit.colour" in refused.stderr
    assert "no such law" in rig("archive", "refit", "--law", "wishful", "--archive", archive).stderr
    record = archive.parent / "runs" / "series" / "run-1.mcap"
    record.write_bytes(record.read_bytes() + b"\0")
    changed = rig("archive", "refit", "--where", "state = 'whole'", "--archive", archive)
    assert changed.returncode == 1
    assert "has changed since it was added" in changed.stderr
    assert Archive(archive).refits.names() == set()
    task = Task(str(archive), record, "0" * 64, Recipe("swings", (), (), "other"))
    assert "other code" in refit(task)
    # a commit since then that changed no source is no other code
    version, _, sources = code_identity().split(" ")
    same = Recipe("swings", (), (), f"{version} (00000000) {sources}")
    assert "has changed since it was added" in refit(task._replace(recipe=same))
    with pytest.raises(ConfigurationError, match=r"no Dask scheduler answers|needs distributed"):
        list(on_cluster(refit, [task], "tcp://127.0.0.1:9"))


@pytest.mark.slow
def test_what_is_given_up_is_in_quarantine(archive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(work: object, tasks: Sequence[Task], processes: int) -> Iterator[tuple[Task, None]]:
        return ((task, None) for task in tasks)

    monkeypatch.setattr("rig.archive.refitting.in_processes", killed)
    first = rig("archive", "refit", "--where", "state = 'whole'", "--archive", archive)
    assert first.returncode == 1
    assert "run-1.mcap: ended its process each time" in first.stderr
    monkeypatch.setattr("rig.archive.refitting.in_processes", in_this_process)
    second = rig("archive", "refit", "--where", "state = 'whole'", "--archive", archive)
    assert "run-1.mcap: left out: in quarantine" in second.stderr
    assert second.stdout == "0 runs fitted again, 0 known already, 0 left out, 1 in quarantine\n"
    (archive / "quarantine").joinpath(*os.listdir(archive / "quarantine")).unlink()
    assert "1 runs fitted again" in done(archive, "--where", "state = 'whole'")


@pytest.mark.slow
def test_a_task_that_ends_its_process_costs_no_other(tmp_path: Path) -> None:
    tasks = ["a", "poison", "b", f"once:{tmp_path / 'once'}", "c", "d"]
    outcomes = sorted(in_processes(deadly, tasks, 2))
    assert outcomes == sorted((task, None if task == "poison" else f"did {task}") for task in tasks)


def started_by(parent: int) -> Iterator[int]:
    """Processes that a process has started to work; not its tracker of resources."""
    for listed in Path(f"/proc/{parent}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in map(int, listed.read_text().split()):
                if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                    yield child


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for processes in /proc")
def test_what_others_end_is_held_against_no_task() -> None:
    """Somebody ends every process that is started: no task is given up, and each is done another time."""
    tasks, ended = ["a", "b", "c"], threading.Event()

    def end_all() -> None:
        while not ended.wait(0.01):
            for child in started_by(os.getpid()):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)

    murderer = threading.Thread(target=end_all)
    murderer.start()
    try:
        outcomes = dict(alone(deadly, tasks))
    finally:
        ended.set()
        murderer.join()
    assert outcomes.keys() == set(tasks)
    for text in outcomes.values():
        assert text is not None
        assert "nothing is held against it" in text
    assert dict(in_processes(deadly, tasks, 2)) == {task: f"did {task}" for task in tasks}


@pytest.mark.slow
def test_what_others_end_each_time_while_a_process_that_does_nothing_lives_is_given_up() -> None:
    """As a machine without memory ends whoever asks for it."""
    assert dict(alone(deadly, ["a", "greedy"])) == {"a": "did a", "greedy": None}
