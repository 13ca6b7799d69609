"""`rig archive`: sessions added once whatever happens, and found again by conditions."""

import json
import os
import re
import shlex
import shutil
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from pyarrow import parquet

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError, RecordError
from rig.archive import add_sessions, find_runs, list_runs, plot_runs, remark
from rig.archive.columns import COLUMNS, DERIVED, OF_REFITS, SAID_OF_RUNS
from rig.archive.listing import narrowed
from rig.archive.remarks import read_remarks
from rig.archive.store import Archive
from rig.presentation import Table, quantity
from tests.rig.command_line import rig

ROOT = Path(__file__).resolve().parents[3]
SAMPLES = ROOT / "tests" / "rig" / "data" / "samples"


def test_a_remark_without_a_time_zone_is_refused_in_a_line(tmp_path: Path) -> None:
    folder = tmp_path / "remarks"
    folder.mkdir()
    for number, zone in enumerate(("Z", "")):
        said = {"utc": f"2026-11-22T00:00:00{zone}", "runs": ["ab"], "note": "dry"}
        (folder / f"{number}.json").write_text(json.dumps(said))
    with pytest.raises(RecordError, match=r"1\.json: cannot be read"):
        read_remarks(tmp_path)


@pytest.fixture
def sessions(tmp_path: Path) -> Path:
    """Two sessions below a folder: one of two runs, the second of them cut short, and one in px."""
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    shutil.copytree(SAMPLES / "uncalibrated", tmp_path / "runs" / "deeper" / "uncalibrated")
    return tmp_path / "runs"


def rows(archive: Path, condition: str = "", columns: str = "*") -> list[dict[str, object]]:
    """Rows of a list as a program gets them."""
    done = rig("archive", "list", condition, "--columns", columns, "--format", "json", "--archive", archive)
    assert done.returncode == 0, done.stderr
    found: list[dict[str, object]] = json.loads(done.stdout)
    return found


def test_what_is_added_is_found_with_the_values_of_its_results(sessions: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    done = rig("archive", "add", sessions, "--archive", archive)
    assert done.stdout == "2 sessions added (3 runs), 0 known already\n"
    assert "run-2.mcap: cut: " in done.stderr
    stated = json.loads((sessions / "series" / "results.json").read_text())["runs"][0]
    (row,) = rows(archive, "sample like '%K8%' and humidity < 41 and b > 0 order by c")
    assert row.keys() >= COLUMNS.keys()
    assert (row["sha256"], row["state"], row["frames"]) == (stated["sha256"], "whole", stated["frames"])
    assert row["b"] == stated["fits"]["exact"]["b"]["value"]
    assert row["u_b"] == stated["fits"]["exact"]["b"]["standard_uncertainty"]
    with RecordReader(sessions / "series" / "run-1.mcap") as record:
        began = record.utc(int(record.spots()["time_ns"][0]))
    assert str(row["began_utc"]).startswith(f"{began:%Y-%m-%dT%H:%M:%S}")
    (cut,) = rows(archive, "state <> 'whole'", "run, c, temperature_c")
    assert cut == {"run": "run-2", "c": None, "temperature_c": 21.5}
    shown = rig("archive", "list", "order by began_utc", "--archive", archive).stdout
    assert "3 runs" in shown
    assert " ± " in shown
    assert shown.index("run-1") < shown.index("run-2")
    judged = rows(archive, "", "verdict_b, verdict_p, verdict_c, verdict_n")
    doubts = sum(verdict not in (None, "determined") for run in judged for verdict in run.values())
    assert shown.count("?") == doubts + bool(doubts), "each is marked, and the mark explained"
    written = tmp_path / "runs.parquet"
    list_runs(archive, "amplitude_unit = 'px'", ["run, final_amplitude"], "parquet", written)
    assert parquet.read_table(written).column_names == ["run", "final_amplitude"]
    with pytest.raises(RecordError, match="exists already"):
        list_runs(archive, "", [], "csv", written)
    written.unlink()
    list_runs(archive, "", ["run, sample, b"], "csv", written)
    assert written.read_text().splitlines()[0] == "run,sample,b"


def test_only_what_is_new_is_added_and_a_run_is_listed_once(sessions: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    add_sessions(archive, [sessions])
    assert add_sessions(archive, [sessions]) == "0 sessions added (0 runs), 2 known already"
    shutil.copytree(sessions / "series", tmp_path / "copy")
    add_sessions(archive, [tmp_path / "copy"])
    assert len(rows(archive)) == 3
    told = add_sessions(tmp_path / "both", [sessions / "series", tmp_path / "copy"])
    assert "(4 runs, 2 of them in more than one session" in told
    assert len(rows(tmp_path / "both")) == 2
    # new results are a new version, and the one that is listed
    series = sessions / "series"
    changed = json.loads((series / "results.json").read_text())
    changed["runs"][0]["fits"]["exact"]["c"]["value"] = 0.5
    (series / "results-2.json").write_text(json.dumps(changed))
    assert add_sessions(archive, [series]) == "1 session added (2 runs), 0 known already"
    assert rows(archive, "b > 0", "c, results") == [{"c": 0.5, "results": "results-2.json"}]
    # a record that goes on has another hash: its earlier version is not listed beside it
    with (series / "run-2.mcap").open("ab") as file:
        file.write(b"\0")
    add_sessions(archive, [series])
    shutil.rmtree(tmp_path / "copy")
    assert len(rows(archive, f"folder = '{series}'")) == 2


def test_what_looks_as_it_was_is_read_only_when_asked(sessions: Path, tmp_path: Path) -> None:
    archive, record = tmp_path / "archive", sessions / "series" / "run-1.mcap"
    add_sessions(archive, [sessions])
    data, found = bytearray(record.read_bytes()), record.stat()
    data[len(data) // 2] ^= 1
    record.write_bytes(data)
    os.utime(record, ns=(found.st_atime_ns, found.st_mtime_ns))
    assert add_sessions(archive, [sessions]) == "0 sessions added (0 runs), 2 known already"
    assert add_sessions(archive, [sessions], read=True) == "1 session added (2 runs), 1 known already"
    assert rows(archive, "state = 'damaged'", "run") == [{"run": "run-1"}]
    # another time alone is no new version
    os.utime(record)
    assert add_sessions(archive, [sessions]) == "0 sessions added (0 runs), 2 known already"


def test_damaged_missing_and_unreadable_records_are_listed_as_such(sessions: Path, tmp_path: Path) -> None:
    series, archive = sessions / "series", tmp_path / "archive"
    data = bytearray((series / "run-1.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    (series / "run-1.mcap").write_bytes(data)
    (series / "run-2.mcap").write_bytes(b"no record")
    (sessions / "deeper" / "uncalibrated" / "run-1.mcap").unlink()
    done = rig("archive", "add", sessions, "--archive", archive)
    flawed = f"{series / 'results.json'}: its results of {series / 'run-1.mcap'} are of an earlier record"
    assert flawed in done.stderr
    found = {(row["run"], row["state"], row["b"], bool(row["flaw"])) for row in rows(archive)}
    assert found == {
        ("run-1", "damaged", None, True),
        ("run-2", "unreadable", None, True),
        ("run-1", "missing", None, True),
    }
    (series / "results.json").write_text("{")
    assert "results.json: cannot be read" in rig("archive", "add", series, "--archive", archive).stderr


def test_results_of_a_record_that_was_replaced_hide_nothing_of_the_new_one(
    sessions: Path, tmp_path: Path
) -> None:
    """A folder of results, made by rig fit -o, whose record was removed and measured again elsewhere."""
    series = sessions / "series"
    tree = json.loads((series / "results.json").read_text())
    tree["runs"] = [tree["runs"][0] | {"record": str(series / "run-1.mcap"), "sha256": "0" * 64}]
    (sessions / "fit").mkdir()
    (sessions / "fit" / "results.json").write_text(json.dumps(tree))
    done = rig("archive", "add", sessions, "--archive", tmp_path / "archive")
    assert f"{sessions / 'fit' / 'results.json'}: its results of {series / 'run-1.mcap'}" in done.stderr
    (row,) = (row for row in rows(tmp_path / "archive") if row["folder"] == str(series) and row["b"])
    assert row["run"] == "run-1"
    assert not [row for row in rows(tmp_path / "archive") if "fit" in Path(row["folder"]).name]


@pytest.mark.slow
def test_a_merged_catalogue_says_the_same_and_is_made_again(sessions: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    add_sessions(archive, [sessions])
    before = rows(archive, "order by sha256")
    for _ in range(2):
        Archive(archive).merge(at_once=1)
        assert rows(archive, "order by sha256") == before
        (merged,) = (archive / "merged").iterdir()
        merged.write_bytes(merged.read_bytes()[:-100])
        assert "delete" in rig("archive", "list", "--archive", archive).stderr
        merged.unlink()
    Archive(archive).merge(at_once=1)
    # what came later than the merged file is listed in place of what is marked there, and merged as well
    series = sessions / "series"
    (series / "results-2.json").write_text(f"{(series / 'results.json').read_text()}\n")
    add_sessions(archive, [series])
    for _ in range(2):
        assert rows(archive, f"folder = '{series}' and b > 0", "results") == [{"results": "results-2.json"}]
        assert len(rows(archive)) == 3
        Archive(archive).merge(at_once=1)
    # a state whose file is taken away is missed where it is needed, and made again
    (newest,) = rows(archive, f"folder <> '{series}'", "version")
    state = archive / "sessions" / f"{newest['version']}.parquet"
    state.unlink()
    shutil.rmtree(archive / "merged")
    assert f"{state}: is missing; rig archive add" in rig("archive", "list", "--archive", archive).stderr
    add_sessions(archive, [sessions])
    assert len(rows(archive)) == 3


def test_two_that_add_at_once_lose_nothing(sessions: Path, tmp_path: Path) -> None:
    """Nothing but files is shared, so that threads stand for processes."""
    for number in range(6):
        shutil.copytree(sessions / "deeper", tmp_path / "many" / str(number))
        with (tmp_path / "many" / str(number) / "uncalibrated" / "run-1.mcap").open("ab") as file:
            file.write(bytes([number]))
    archive = tmp_path / "archive"

    def add(_: int) -> None:
        add_sessions(archive, [tmp_path / "many"])
        Archive(archive).merge(at_once=1)

    with ThreadPoolExecutor(2) as two:
        list(two.map(add, range(2)))
    assert len(rows(archive)) == 6
    assert len(list((archive / "sessions").iterdir())) == 6
    assert len(list((archive / "merged").iterdir())) in (1, 2)


@pytest.mark.slow
def test_the_documented_commands_run_and_the_documented_columns_exist(
    sessions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(sessions.parent / "data"))
    text = (ROOT / "docs" / "archive.md").read_text(encoding="utf-8")
    reference = (ROOT / "docs" / "reference" / "archive.md").read_text(encoding="utf-8")
    lines = re.findall(r"^ {4}(rig archive .*)$", text, re.MULTILINE)
    assert len(lines) >= 5
    for line in lines:
        done = rig(*shlex.split(line.split("  #")[0])[1:], cwd=sessions.parent)
        assert done.returncode == 0, f"{line}: {done.stderr}"
    documented = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", reference, re.MULTILINE))
    derived = {f"{u}{name}" for name in DERIVED for u in ("", "u_")}
    columns = {name: one.meaning for name, one in {**COLUMNS, **OF_REFITS}.items() if name not in derived}
    assert documented == columns | SAID_OF_RUNS


@pytest.mark.slow
def test_tags_and_notes_belong_to_the_record(sessions: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    add_sessions(archive, [sessions])
    (first,) = rows(archive, "b > 0", "sha256, session")
    sha256, session = str(first["sha256"]), str(first["session"])
    assert remark(archive, [session[:8]], add="good") == "2 runs"
    assert remark(archive, [], "b > 0", note="cleaned") == "1 run"
    remark(archive, [sha256[:6]], remove="good")
    remark(archive, [sha256], add="humid")
    found = {str(row["run"]): row for row in rows(archive, "len(tags) > 0", "run, tags, notes")}
    assert (found["run-1"]["tags"], found["run-2"]["tags"]) == (["humid"], ["good"])
    assert str(found["run-1"]["notes"]).endswith(": cleaned']")
    shown = rig("archive", "show", sha256[:8], "--archive", archive).stdout
    assert "humid" in shown
    assert "u_b" not in shown
    # the catalogue made again, with a session that has grown: what was said is still said of the record
    shutil.rmtree(archive / "sessions")
    shutil.copy(sessions / "deeper" / "uncalibrated" / "run-1.mcap", sessions / "series" / "run-3.mcap")
    add_sessions(archive, [sessions])
    assert rows(archive, "'humid' in tags", "sha256") == [{"sha256": sha256}]
    for name, said in {"0000": "no run of the archive begins so", "nothing": "names no run"}.items():
        with pytest.raises(ConfigurationError, match=said):
            remark(archive, [name], add="good")
    with pytest.raises(ConfigurationError, match="no run is meant"):
        remark(archive, [], "b < 0", add="good")


def test_a_plot_has_a_bar_for_each_run_that_has_both_columns(sessions: Path, tmp_path: Path) -> None:
    archive, picture = tmp_path / "archive", tmp_path / "c.svg"
    add_sessions(archive, [sessions])
    assert plot_runs(archive, "began_utc", "c", "sample", "", picture) == f"{picture}: 1 of 3 runs"
    with pytest.raises(RecordError, match="exists already"):
        plot_runs(archive, "began_utc", "c", "", "", picture)
    for x, y, file, said in (
        ("began_utc", "colour", "a.svg", "colour: is not a column"),
        ("c", "sample", "a.svg", "holds no numbers"),
        ("c", "b", "a.pdf", "neither .svg nor .png"),
        ("scale_hardness", "b", "a.svg", "none of 3 runs has both"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            plot_runs(archive, x, y, "", "", tmp_path / file)


def test_a_condition_reads_runs_and_nothing_else(sessions: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    with pytest.raises(ConfigurationError, match="holds no sessions"):
        list_runs(archive, "", [], "table", None)
    add_sessions(archive, [sessions])
    for condition, said in {
        "b > 0; drop view runs": "more than one",
        "temperature_c < '45 %'": "condition or columns: Could not convert string '45 %'",
        "hardness > 3": "docs/reference/archive.md lists the columns",
        f"exists(from read_text('{sessions}/series/session.json'))": "disabled",
    }.items():
        with pytest.raises(ConfigurationError, match=said):
            list_runs(archive, condition, [], "table", None)
    with pytest.raises(ConfigurationError, match="holds no session"):
        add_sessions(archive, [archive])


def test_without_duckdb_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "duckdb", None)
    done = rig("archive", "add", tmp_path, "--archive", tmp_path / "archive")
    assert done.returncode == 2
    assert done.stderr == (
        f"rig: rig archive needs duckdb and pyarrow: {sys.executable} -m pip install duckdb pyarrow\n"
    )


def test_a_narrow_terminal_shows_whole_values_and_says_what_it_lacks() -> None:
    head = ["id", "run", "sample", "began_utc", "b", "p", "c", "state"]
    values = ["0.03005 ± 0.00038", "0.9438 ± 0.0017", "(1.01 ± 0.14) × 10⁻⁷ ?"]
    row = ["09dd9188", "run-1", "SIMULATED: steel ball on K8 glass", "2026-11-22 00:58", *values, "whole"]
    table = Table("runs", "", head, [], head, [row], "1 run")
    assert narrowed(table, 170) == table
    for width, lacking in {80: ("began_utc", "p"), 60: ("sample", "began_utc", "p", "state")}.items():
        found = narrowed(table, width)
        assert [*found.head] == [name for name in head if name not in lacking]
        (shown,) = found.shown
        assert sum(max(map(len, cell.split("\n"))) + 2 for cell in shown) - 2 <= width
        assert {values[0], values[2], "09dd9188"} <= {*shown}
        assert f"no room for {', '.join(lacking)}: " in found.note
        assert "SIMULATED" in f"{shown} {found.note}"


def test_a_list_for_programs_has_an_object_a_line(sessions: Path, tmp_path: Path) -> None:
    add_sessions(tmp_path / "archive", [sessions])
    words = ("archive", "list", "order by run", "--json", "--archive", tmp_path / "archive")
    lines = [json.loads(line) for line in rig(*words).stdout.splitlines()]
    assert [line["kind"] for line in lines] == ["run"] * len(rows(tmp_path / "archive"))
    assert {"id", "b", "u_b", "verdict_b", "camera"} <= lines[0].keys()
    refused = rig(*words, "-o", tmp_path / "runs.json")
    assert refused.returncode == 2
    assert "--format json -o FILE" in refused.stderr


def test_runs_are_found_by_words_page_by_page(sessions: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    add_sessions(archive, [sessions])
    everything = find_runs(archive, "")
    assert (everything.found, everything.all, len(everything.rows)) == (3, 3, 3)
    begun = [row["begun (UTC)"] for row in everything.rows]
    assert begun == sorted(begun, reverse=True)
    k8 = find_runs(archive, "k8 SERIES whole")
    assert [row["run"] for row in k8.rows] == ["run-1"]
    assert (k8.found, k8.all) == (1, 3)
    (row,) = k8.rows
    assert " ± " in row[quantity("b").label]
    assert find_runs(archive, "", first=1, most=1).rows == everything.rows[1:2]
    assert find_runs(archive, "nobody' or '1'='1").found == 0
    with pytest.raises(ConfigurationError, match="holds no sessions"):
        find_runs(tmp_path / "none", "")
