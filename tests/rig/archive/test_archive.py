"""`rig archive`: what folders hold, listed by conditions, and read again when it has changed."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import duckdb
import pytest

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError, RecordError
from rig.archive import (
    add_folders,
    check_archive,
    find_runs,
    list_runs,
    listing,
    ordered_runs,
    query_runs,
    update_archive,
)
from rig.archive.listing import open_for_writing, write_sessions
from rig.archive.session_rows import COLUMNS, DERIVED, PARAMETERS, row_columns
from rig.terminal import NOT_KNOWN
from tests.rig.command_line import SAMPLES, rig

ROOT = Path(__file__).resolve().parents[3]


def made_sessions(folder: Path) -> Path:
    """Two sessions below a folder: one of two runs, the second of them cut short, and one in px."""
    shutil.copytree(SAMPLES / "series", folder / "runs" / "series")
    shutil.copytree(SAMPLES / "uncalibrated", folder / "runs" / "deeper" / "uncalibrated")
    return folder / "runs"


@pytest.fixture
def sessions(tmp_path: Path) -> Path:
    return made_sessions(tmp_path)


@pytest.fixture
def archive(sessions: Path, tmp_path: Path) -> Path:
    path = tmp_path / "archive.duckdb"
    add_folders(path, [sessions])
    return path


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of the same sessions, in which nobody writes."""
    folder = tmp_path_factory.mktemp("kept")
    add_folders(folder / "archive.duckdb", [made_sessions(folder)])
    return folder / "archive.duckdb"


def rows(archive: Path, condition: str = "", columns: str = "*") -> list[dict[str, Any]]:
    names, found = query_runs(archive, columns, condition)
    return [dict(zip(names, row, strict=True)) for row in found]


def test_what_is_added_is_listed_with_the_values_of_its_results(sessions: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive.duckdb"
    done = rig("archive", "add", sessions, "--archive", archive)
    assert done.stdout == "2 sessions read (3 runs), 0 unchanged, 0 gone\n"
    assert "run-2.mcap: cut: " in done.stderr
    stated = json.loads((sessions / "series" / "results.json").read_text())["runs"][0]
    (row,) = rows(archive, "sample like '%K8%' and humidity < 41 and b > 0 order by c")
    assert row.keys() >= COLUMNS.keys()
    assert (row["sha256"], row["state"], row["frames"]) == (stated["sha256"], "whole", stated["frames"])
    for name in ("b", "p", "c", "n"):
        estimate = stated["fits"]["exact"][name]
        assert (row[name], row[f"u_{name}"]) == (estimate["value"], estimate["standard_uncertainty"])
    # of the exact fit another mean stood here, without the clock: 1.2 ms off, 0.2 µs uncertain
    decay = {one["quantity"]: one for one in stated["table"] if one["fit"] == "decay"}
    for name in ("mean_period_s", "log_decrement"):
        assert (row[name], row[f"u_{name}"]) == (decay[name]["value"], decay[name]["u_total"])
    with RecordReader(sessions / "series" / "run-1.mcap") as record:
        began = record.utc(int(record.spots()["time_ns"][0]))
    assert str(row["began_utc"]).startswith(f"{began:%Y-%m-%d %H:%M:%S}")
    (cut,) = rows(archive, "state = 'cut'", "run, c, temperature_c")
    assert cut == {"run": "run-2", "c": None, "temperature_c": 21.5}
    shown = rig("archive", "list", "order by began_utc", "--archive", archive).stdout
    assert "SIMULATED:" in shown
    assert "3 runs" in shown
    assert " ± " in shown
    lines = rig("archive", "list", "order by run", "--json", "--archive", archive).stdout.splitlines()
    assert [json.loads(line)["run"] for line in lines] == ["run-1", "run-1", "run-2"]
    written = tmp_path / "runs.csv"
    list_runs(archive, "order by run", "run, sample, b", written)
    assert written.read_text().splitlines()[0] == "run,sample,b"
    with pytest.raises(ConfigurationError, match="exists already"):
        list_runs(archive, "", "run", written)
    assert "leave out one" in rig("archive", "list", "--json", "-o", tmp_path / "x.csv").stderr


def test_a_narrow_terminal_shows_what_matters_most(
    kept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for width, columns in ((200, "humidity_percent"), (100, "id run sample began_utc b c state")):
        monkeypatch.setattr("rig.archive.listing.screen_width", lambda width=width: width)
        list_runs(kept, "", "", None)
        out = capsys.readouterr().out
        assert set(columns.split()) <= set(out.splitlines()[0].split())
        assert ("a wider window" in out) == (width == 100)


def test_runs_are_shown_by_the_first_characters_of_their_hash(kept: Path) -> None:
    (run,) = rows(kept, "b > 0")
    shown = rig("archive", "show", run["sha256"][:8], "--archive", kept).stdout
    assert "SIMULATED: " in shown
    assert re.search(r"^c +\(\d\.\d+ ± \d\.\d+\) × 10⁻", shown, re.MULTILINE)
    both = rig("archive", "show", run["session"][:12], "--archive", kept).stdout
    assert len(re.findall(r"^sha256 ", both, re.MULTILINE)) == 2
    for name, why in (("0000", "no run of the archive begins so"), ("run-1", "names no run")):
        assert why in rig("archive", "show", name, "--archive", kept).stderr


def test_only_what_has_changed_is_read(sessions: Path, archive: Path) -> None:
    assert update_archive(archive) == "0 sessions read (0 runs), 2 unchanged, 0 gone"
    # new results are the ones that are listed
    series = sessions / "series"
    changed = json.loads((series / "results.json").read_text())
    (row,) = (row for row in changed["runs"][0]["table"] if (row["fit"], row["quantity"]) == ("exact", "p"))
    row["value"] = 0.5
    (series / "results-2.json").write_text(json.dumps(changed))
    assert update_archive(archive) == "1 session read (2 runs), 1 unchanged, 0 gone"
    assert rows(archive, "b > 0", "p, results") == [{"p": 0.5, "results": "results-2.json"}]
    # a record that goes on has another hash; a session of a new folder is found, one that was removed is gone
    with (series / "run-2.mcap").open("ab") as file:
        file.write(b"\0")
    shutil.move(sessions / "deeper", sessions / "moved")
    assert update_archive(archive) == "2 sessions read (3 runs), 0 unchanged, 1 gone"
    assert {Path(row["folder"]).parent.name for row in rows(archive)} == {"runs", "moved"}
    assert len(rows(archive)) == 3
    # a disk that is not there takes nothing away
    sessions.rename(sessions.with_name("elsewhere"))
    assert update_archive(archive) == "0 sessions read (0 runs), 0 unchanged, 0 gone"
    assert len(rows(archive)) == 3


def test_a_run_in_two_folders_is_listed_once(sessions: Path, archive: Path, tmp_path: Path) -> None:
    shutil.copytree(sessions / "series", tmp_path / "copy")
    assert add_folders(archive, [tmp_path / "copy"]) == "1 session read (2 runs), 0 unchanged, 0 gone"
    assert len(rows(archive)) == 3
    assert len(rows(archive, f"folder = '{tmp_path / 'copy'}'")) == 2
    shutil.rmtree(tmp_path / "copy")
    assert add_folders(archive, [sessions]) == "0 sessions read (0 runs), 2 unchanged, 0 gone"
    tmp_path.joinpath("copy").mkdir()
    assert update_archive(archive) == "0 sessions read (0 runs), 2 unchanged, 1 gone"
    assert len(rows(archive, f"folder = '{sessions / 'series'}'")) == 2


def test_damaged_missing_and_unreadable_records_are_listed_as_such(sessions: Path, archive: Path) -> None:
    series = sessions / "series"
    data = bytearray((series / "run-1.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    (series / "run-1.mcap").write_bytes(data)
    (series / "run-2.mcap").write_bytes(b"no record")
    (sessions / "deeper" / "uncalibrated" / "run-1.mcap").unlink()
    done = rig("archive", "update", "--archive", archive)
    flawed = f"{series / 'results.json'}: its results of {series / 'run-1.mcap'} are of an earlier record"
    assert flawed in done.stderr
    found = {(row["run"], row["state"], row["b"], bool(row["flaw"])) for row in rows(archive)}
    assert found == {
        ("run-1", "damaged", None, True),
        ("run-2", "unreadable", None, True),
        ("run-1", "missing", None, True),
    }
    (series / "results.json").write_text("{")
    assert "results.json: cannot be read" in rig("archive", "update", "--archive", archive).stderr


def test_results_of_a_record_that_was_replaced_hide_nothing_of_the_new_one(
    sessions: Path, archive: Path
) -> None:
    """Results made by rig fit -o, whose record was removed and measured again elsewhere."""
    series = sessions / "series"
    tree = json.loads((series / "results.json").read_text())
    tree["runs"] = [tree["runs"][0] | {"record": str(series / "run-1.mcap"), "sha256": "0" * 64}]
    (sessions / "fit").mkdir()
    (sessions / "fit" / "results.json").write_text(json.dumps(tree))
    done = rig("archive", "update", "--archive", archive)
    assert f"{sessions / 'fit' / 'results.json'}: its results of {series / 'run-1.mcap'}" in done.stderr
    assert not [row for row in rows(archive) if Path(row["folder"]).name == "fit"]


def test_a_check_finds_what_is_not_as_it_was(
    sessions: Path, archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check_archive(archive) == 0
    assert capsys.readouterr().out == "3 runs read, 0 differences\n"
    record, results = sessions / "series" / "run-1.mcap", sessions / "series" / "results.json"
    data, found = bytearray(record.read_bytes()), record.stat()
    data[len(data) // 2] ^= 1
    record.write_bytes(data)
    os.utime(record, ns=(found.st_atime_ns, found.st_mtime_ns))
    assert update_archive(archive).startswith("0 sessions read"), "it looks as it was"
    results.write_bytes(results.read_bytes() + b"\n")
    (sessions / "deeper" / "uncalibrated" / "run-1.mcap").unlink()
    with (sessions / "series" / "run-2.mcap").open("ab") as file:
        file.write(b"\0")
    assert check_archive(archive) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 5
    for path, why in (
        (record, "was whole and is damaged"),
        (results, "has changed since it was read"),
        (sessions / "series" / "run-2.mcap", "has other bytes than when it was read"),
        (sessions / "deeper" / "uncalibrated" / "run-1.mcap", "is not there any more"),
    ):
        assert any(line.startswith(f"{path}: {why}") for line in lines), lines
    update_archive(archive, read=True)
    assert check_archive(archive) == 0


@pytest.mark.parametrize(
    ("condition", "columns", "why"),
    [
        ("colour = 3", "*", "condition 'colour = 3'"),
        ("", "colour", "columns 'colour'"),
        ("b >", "*", "syntax error"),
        ("colour(b) > 1", "*", "condition 'colour(b) > 1'"),
        ("regexp_matches(run, run || '(')", "*", "condition or columns: "),
        ("humidity_percent = '45 %'", "*", "Could not convert"),
        ("true; drop table every_run", "*", "holds a semicolon"),
        ("sample in (select * from read_csv('/etc/hostname'))", "*", "disabled by configuration"),
    ],
)
def test_a_condition_that_is_none_is_said(kept: Path, condition: str, columns: str, why: str) -> None:
    with pytest.raises(ConfigurationError, match=re.escape(why)):
        query_runs(kept, columns, condition)


def test_what_is_no_archive_is_said(sessions: Path, tmp_path: Path) -> None:
    for words in (("list",), ("update",), ("check",), ("refit",)):
        done = rig("archive", *words, "--archive", tmp_path / "none")
        assert (done.returncode, done.stdout) == (2, "")
        assert "none: no such archive; rig archive add FOLDER --archive FILE makes one" in done.stderr
        assert (
            "runs: is a folder; an archive is a file" in rig("archive", *words, "--archive", sessions).stderr
        )
    (tmp_path / "empty").mkdir()
    assert "holds no session" in rig("archive", "add", tmp_path / "empty", cwd=tmp_path).stderr
    (tmp_path / "text").write_text("no database " * 1000)
    assert "text: cannot be used" in rig("archive", "list", "--archive", tmp_path / "text").stderr
    in_no_folder = rig("archive", "add", sessions, "--archive", tmp_path / "none" / "a.duckdb").stderr
    assert "none is no folder that may be written" in in_no_folder
    # the message spoke of a condition, which nobody had stated
    no_text = sessions.rename(os.fsdecode(bytes(tmp_path) + b"/caf\xe9"))
    with pytest.raises(RecordError, match=r"a\.duckdb: cannot be written: .*surrogate"):
        add_folders(tmp_path / "a.duckdb", [no_text])


def test_an_archive_of_another_version_is_made_again_from_its_folders(archive: Path) -> None:
    before = rows(archive, "order by sha256", "* exclude added_utc")
    with open_for_writing(archive) as connection:
        connection.execute("drop view runs; alter table every_run drop column gamma_pa")
    with pytest.raises(RecordError, match="another version made it; rig archive update"):
        rows(archive)
    update_archive(archive)
    assert rows(archive, "order by sha256", "* exclude added_utc") == before


UPDATES = """
import os, signal, sys, time
from pathlib import Path
import duckdb
from rig.archive import update_archive
for line in sys.stdin:
    begun_s = time.monotonic()
    updating = os.fork()
    if not updating:
        update_archive(Path(sys.argv[1]), read=True)
        os._exit(0)
    while not os.waitpid(updating, os.WNOHANG)[0]:
        if time.monotonic() > begun_s + float(line):
            os.kill(updating, signal.SIGKILL)
        time.sleep(0.002)
    print(time.monotonic() - begun_s, flush=True)
"""
"""Updates an archive each time it is asked, and kills that after so many s; says how long it lasted."""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="ends a process by a signal")
def test_an_update_that_is_killed_costs_an_update(sessions: Path, archive: Path) -> None:
    """Killed at any moment, also in the middle of a transaction, the archive is as before or after it."""
    for number in range(4):
        shutil.copytree(sessions / "series", sessions / f"more-{number}")
    command = [sys.executable, "-c", UPDATES, str(archive)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as updating:
        said, asked = updating.stdout, updating.stdin
        assert said is not None
        assert asked is not None

        def updated(within_s: float) -> float:
            print(within_s, file=asked, flush=True)
            return float(said.readline())

        whole_s = updated(600.0)
        before = rows(archive, "order by folder, run", "* exclude added_utc")
        for part in range(1, 9, 2):
            updated(0.12 * part * whole_s)
            assert rows(archive, "order by folder, run", "* exclude added_utc") == before
        asked.close()
    assert "6 unchanged" in update_archive(archive)


def test_two_that_add_at_once_lose_nothing(sessions: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive.duckdb"
    words = [sys.executable, "-m", "rig", "archive", "add", "--archive", archive]
    adding = [subprocess.Popen([*words, sessions / name], cwd=ROOT) for name in ("series", "deeper")]
    assert [process.wait(60) for process in adding] == [0, 0]
    assert len(rows(archive)) == 3
    assert update_archive(archive).startswith("0 sessions read (0 runs), 2 unchanged")


def test_an_archive_that_is_being_made_is_never_found_half_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = tmp_path / "archive.duckdb"
    connect, opened = duckdb.connect, list[str]()

    def watched(file: str, *settings: Any) -> Any:
        # what does not exist yet, DuckDB makes in several steps
        assert Path(file) != archive or archive.is_file()
        opened.append(file)
        return connect(file, *settings)

    monkeypatch.setattr(duckdb, "connect", watched)
    with open_for_writing(archive):
        pass
    assert str(archive) in opened
    assert [path.name for path in tmp_path.iterdir()] == [archive.name]


def test_numbers_are_kept_to_the_last_digit_and_a_bound_of_zero_is_listed_as_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = [0.1, 1 / 3, 6.02214076e23, 5e-324, 1.7976931348623157e308, -2.5e-9]
    bound = {"verdict_c": "upper bound", "upper_c": 0.0}
    with open_for_writing(tmp_path / "archive.duckdb") as connection:
        made = [{"sha256": f"{k}", "folder": "f", "b": value} | bound for k, value in enumerate(values)]
        write_sessions(connection, {"f": ""}, made)
    assert [row["b"] for row in rows(tmp_path / "archive.duckdb", "order by sha256")] == values
    list_runs(tmp_path / "archive.duckdb", "", "c, verdict_c, upper_c", None)
    assert capsys.readouterr().out.count("< 0 (95 %)") == len(values)


def test_runs_are_listed_as_they_were_measured(tmp_path: Path) -> None:
    """The tenth run of a session stands after its second, although its clock was set back meanwhile."""
    order = {
        ("b", "run-1"): "2026-11-30 10:00:00",
        ("a", "run-2"): "2026-11-30 11:00:00",
        ("a", "run-10"): "2026-11-30 10:30:00",
        ("c", "run-1"): "2026-11-30 12:00:00",
        ("a", "run-11"): "2026-12-01 01:00:00",
        ("d", "run-1"): None,
    }
    found = [
        {"folder": folder, "run": run, "sha256": f"{folder}{run}", "began_utc": began, "results": "x"}
        for (folder, run), began in order.items()
    ]
    with open_for_writing(tmp_path / "archive.duckdb") as connection:
        write_sessions(connection, dict.fromkeys("abcd", "hash"), found[::-1])
    for condition, count in (("", 6), ("sha256 <> 'x'", 6), ("limit 3", 3)):
        listed = rows(tmp_path / "archive.duckdb", condition, "folder, run")
        assert [(row["folder"], row["run"]) for row in listed] == [*order][:count]
    # so are those of a campaign
    assert [(row[3], row[1]) for row in ordered_runs(tmp_path / "archive.duckdb", "")] == [*order]


def test_every_column_stands_in_the_reference() -> None:
    text = (ROOT / "docs" / "reference" / "archive.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `(\w+)` \| .+ \|$", text, re.MULTILINE))
    of_rows = {
        column for name in (*PARAMETERS, *DERIVED) for column in (*row_columns(name), f"verdict_{name}")
    }
    assert listed == {name for name in COLUMNS if name not in of_rows}
    for name in PARAMETERS:
        assert f"`{name}`" in text


def test_runs_are_found_by_words(kept: Path) -> None:
    table = find_runs(kept, "k8 STEEL run-1", 9)
    assert len(table.shown) == 1
    shown = dict(zip(table.head, table.shown[0], strict=True))
    assert shown["sample"].startswith("SIMULATED: ")
    assert "±" in shown["c"]
    assert [len(find_runs(kept, words, 2).shown) for words in ("it's", "")] == [0, 2]


def test_a_cell_has_the_whole_uncertainty() -> None:
    names = ("b", "u_b", "u_total_b", "c", "verdict_c", "upper_c", "temperature_c")
    one = listing._table(names, [[0.0312, 0.001, 0.004, None, "upper bound", None, 21.53841]])
    assert (one.head, one.shown) == (["b", "c", "temperature_c"], [["0.0312 ± 0.0040", NOT_KNOWN, "21.538"]])
    assert one.note == "1 run"
