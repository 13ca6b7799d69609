"""What is listed is what was seen last, whatever clocks, names and disks say."""

import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.repaired import repaired
from processing.errors import ConfigurationError, RecordError
from rig.archive import add_sessions, list_runs, remark, thin_runs
from rig.archive.facts import FactLog
from rig.archive.refits import Recipe, Task, refit
from rig.archive.remarks import read_remarks
from rig.archive.store import CONFIG, Archive
from rig.commands.inputs import records_in
from tests.acquisition.record.hanging_disk import Mounted, NoFuse, mounted

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"


@pytest.fixture
def series(tmp_path: Path) -> Path:
    """A session of two runs, the second of them cut short."""
    return shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    return tmp_path / "archive"


def listed(archive: Path, columns: str = "run, folder, c, results, state") -> list[tuple[Any, ...]]:
    question = f"select {columns} from runs order by run, sha256"
    found: list[tuple[Any, ...]] = Archive(archive).connection().execute(question).fetchall()
    return found


def wrong_results(series: Path) -> Path:
    """Results that somebody takes back."""
    tree = json.loads((series / "results.json").read_text())
    tree["runs"][0]["fits"]["exact"]["c"]["value"] = 0.5
    path = series / "results-2.json"
    path.write_text(json.dumps(tree))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("merged", [False, True])
def test_results_that_are_withdrawn_are_no_longer_listed(series: Path, archive: Path, merged: bool) -> None:
    def add() -> str:
        told = add_sessions(archive, [series])
        if merged:
            Archive(archive).merge(at_once=1)
        return told

    add()
    before = listed(archive)
    wrong = wrong_results(series)
    add()
    assert [row[2:4] for row in listed(archive, "run, folder, c, results, state") if row[2]] == [
        (0.5, "results-2.json")
    ]
    wrong.unlink()
    assert add() == "1 session added (2 runs), 0 known already"
    assert listed(archive) == before
    assert add() == "0 sessions added (0 runs), 1 known already"
    assert listed(archive) == before
    versions = Archive(archive).connection().execute("select count(distinct version) from versions")
    assert versions.fetchone() == (2,)


@pytest.mark.slow
def test_a_record_that_is_restored_is_what_it_was(series: Path, archive: Path) -> None:
    add_sessions(archive, [series])
    before = listed(archive, "*")
    record = series / "run-1.mcap"
    whole = record.read_bytes()
    record.write_bytes(whole[:-1000])
    add_sessions(archive, [series])
    assert listed(archive, "run, state")[0] == ("run-1", "cut")
    record.write_bytes(whole)
    add_sessions(archive, [series])
    same = [name for name in range(len(before[0])) if before[0][name] == listed(archive, "*")[0][name]]
    # but for when it was added and by which times its files are known
    assert len(same) >= len(before[0]) - 2


@pytest.mark.slow
def test_a_folder_that_was_moved_away_and_back_is_where_it_is(series: Path, archive: Path) -> None:
    """Its files are as they were: it is not read again, and yet where the runs were seen last is said."""
    add_sessions(archive, [series])
    before = listed(archive)
    moved = series.with_name("moved")
    series.rename(moved)
    add_sessions(archive, [moved])
    assert {row[1] for row in listed(archive)} == {str(moved)}
    moved.rename(series)
    assert add_sessions(archive, [series]) == "0 sessions added (0 runs), 1 known already"
    assert listed(archive) == before
    # of two places that were seen by one command the last, and nothing is written where nothing changes
    shutil.copytree(series, moved)
    for _ in range(2):
        add_sessions(archive, [series.parent])
        assert {row[1] for row in listed(archive)} == {str(series)}
    log = FactLog(archive)
    before_names = log.names()
    add_sessions(archive, [series.parent])
    assert log.names() == before_names


@pytest.mark.slow
def test_no_clock_decides_what_is_listed(
    series: Path, archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import datetime

    def clock(year: int) -> Callable[[], datetime.datetime]:
        return lambda: datetime.datetime(year, 1, 1)

    monkeypatch.setattr("rig.archive.session_rows.now_utc", clock(2041))
    add_sessions(archive, [series])
    monkeypatch.setattr("rig.archive.session_rows.now_utc", clock(2026))
    wrong_results(series)
    add_sessions(archive, [series])
    assert listed(archive, "c, results, year(added_utc)")[0] == (0.5, "results-2.json", 2026)
    # and so of results that were made again
    record, (sha256,) = series / "run-1.mcap", listed(archive, "sha256")[0]
    for year, settings in ((2041, ()), (2026, ("fit.robust=true",))):
        monkeypatch.setattr("rig.archive.refits.now_utc", clock(year))
        turn = Archive(archive).refit_turn() + 1
        from rig.archive.refits import code_identity

        recipe = Recipe("swings", (), settings, code_identity())
        assert refit(Task(str(archive), record, sha256, recipe, turn)) == ""
    found = Archive(archive).connection(refits=True)
    assert found.execute("select settings from refits where newest").fetchall() == [("fit.robust=true",)]


def test_no_clock_decides_which_tags_hold(
    series: Path, archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import datetime as real

    class Ahead(real.datetime):
        @classmethod
        def now(cls, tz: Any = None) -> "Ahead":
            return cls(2041, 1, 1, tzinfo=tz)

    add_sessions(archive, [series])
    monkeypatch.setattr("rig.archive.remarks.datetime.datetime", Ahead)
    remark(archive, [], "run = 'run-1'", add="good")
    monkeypatch.undo()
    remark(archive, [], "run = 'run-1'", remove="good")
    assert read_remarks(archive).tags == [[]]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Mounted]:
    base = tmp_path / "fuse"
    base.mkdir()
    try:
        with mounted(base) as found:
            yield found
    except NoFuse as why:
        pytest.skip(str(why))


def test_a_read_error_is_an_error_and_nobodys_identity(
    disk: Mounted, archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # of FUSE only what a test needs is there: the folder behind it is filled instead
    shutil.copytree(SAMPLES / "series", disk.hangs.with_name("source") / "series")
    shutil.copytree(SAMPLES / "uncalibrated", disk.hangs.with_name("source") / "other")
    series = disk.folder / "series"
    add_sessions(archive, [series])
    before = listed(archive)
    size = (series / "run-1.mcap").stat().st_size // 2 // 4096 * 4096
    disk.spoil(size, size + 4096)
    with pytest.raises(RecordError, match="cannot be read and stay as they were"):
        add_sessions(archive, [disk.folder], read=True)
    said = capsys.readouterr().err
    assert "run-1.mcap: cannot be read: Input/output error" in said
    assert "stays as it was in the archive" in said
    assert "earlier record" not in said
    assert listed(archive)[: len(before)] == before


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_pipe_among_the_records_does_not_hang(
    series: Path, archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(series / "run-3.mcap")
    assert add_sessions(archive, [series]) == "1 session added (2 runs), 0 known already"
    assert "run-3.mcap: is not a file but a pipe" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_what_a_killed_thin_left_is_taken_away_by_the_next(series: Path, archive: Path) -> None:
    import datetime

    add_sessions(archive, [series])
    left = series / ".run-1.mcap.0123abcd"
    left.write_bytes(b"half")
    (series / ".run-1.mcap.0123abcd.claim").touch()
    rule = {"drop_after": 0, "recompress_after": None}
    today = datetime.date(2027, 11, 22)
    thin_runs(archive, [], "run = 'run-1'", **rule, agreed=lambda question: True, today=today)
    assert not [path for path in series.iterdir() if path.name.startswith(".")]
    left.write_bytes(b"half")
    add_sessions(archive, [series])
    assert not left.exists()


def test_a_condition_that_needs_too_much_memory_is_no_wrong_condition(
    series: Path, archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_sessions(archive, [series])
    monkeypatch.setattr("rig.archive.store.CONFIG", {**CONFIG, "memory_limit": "64MB", "threads": 1})
    condition = "c > (select len(string_agg(repeat(a.range::varchar, 100000))) from range(10000) as a)"
    with pytest.raises(RecordError, match="needs more memory than"):
        list_runs(archive, condition, [], "table", None)


def test_a_vanished_log_is_a_refusal(series: Path, archive: Path) -> None:
    add_sessions(archive, [series])
    add_sessions(archive, [shutil.copytree(SAMPLES / "uncalibrated", series.parent / "more")])
    log = archive / "facts"
    names = sorted(path.name for path in log.iterdir())
    assert len(names) == 3
    for gone in (names[0], names[1]):
        data = (log / gone).read_bytes()
        (log / gone).unlink()
        with pytest.raises(RecordError, match=f"{gone}: is missing"):
            listed(archive)
        (log / gone).write_bytes(data)
    log.rename(archive / "elsewhere")
    with pytest.raises(RecordError, match="facts: is missing"):
        listed(archive)
    with pytest.raises(RecordError, match="facts: is missing"):
        add_sessions(archive, [series])
    (archive / "elsewhere").rename(log)
    (archive / "archive.json").rename(archive / "archive.old")
    with pytest.raises(RecordError, match=r"archive\.json: is missing"):
        listed(archive)
    # made again as it says: remarks stay, all else follows from the records
    for name in ("facts", "sessions"):
        shutil.rmtree(archive / name)
    with pytest.raises(ConfigurationError, match="holds no sessions"):
        listed(archive)
    add_sessions(archive, [series.parent])
    assert len(listed(archive)) == 3


def test_a_changed_fact_a_swapped_one_and_a_newer_one_are_refused(series: Path, archive: Path) -> None:
    add_sessions(archive, [series])
    log = archive / "facts"
    first, last = sorted(log.iterdir())
    data = last.read_bytes()
    for place in (5, len(data) // 2, len(data) - 3):
        last.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        with pytest.raises(RecordError, match="its bytes have changed"):
            listed(archive)
    last.write_bytes(first.read_bytes())
    with pytest.raises(RecordError, match="under another name"):
        listed(archive)


def test_of_a_record_and_its_repaired_copies_the_fullest_is_taken(series: Path, archive: Path) -> None:
    """Half a copy, as a version of before left it where it was killed, is not; a whole one is."""
    cut, half = series / "run-2.mcap", series / "run-2-recovered.mcap"
    half.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    add_sessions(archive, [series])
    assert [row[0] for row in listed(archive, "run")] == ["run-1", "run-2"]
    assert records_in(series) == [series / "run-1.mcap", cut]
    whole, _ = repaired(cut)
    add_sessions(archive, [series])
    assert listed(archive, "run, state")[1] == ("run-2-recovered-2", "whole")
    assert records_in(series) == [series / "run-1.mcap", whole]


def test_a_state_that_is_damaged_is_missed_and_never_merged_away(series: Path, archive: Path) -> None:
    shutil.copytree(SAMPLES / "uncalibrated", series.parent / "other")
    add_sessions(archive, [series.parent])
    before = listed(archive)
    for state in sorted((archive / "sessions").iterdir()):
        data = state.read_bytes()
        state.write_bytes(data[:100] + b"\0" + data[101:])
        for use in (lambda: Archive(archive).merge(at_once=1), lambda: listed(archive)):
            with pytest.raises(RecordError, match=state.name):
                use()
        # looked at again, it is made again; and seen elsewhere, nothing is lost of it
        add_sessions(archive, [series.parent], read=True)
        assert (listed(archive), state.read_bytes()) == (before, data)
