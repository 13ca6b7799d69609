"""Nothing that a command shows of a blind archive tells a true value."""

import json
import os
import shutil
import stat
from pathlib import Path
from typing import Any

import pytest

from processing.errors import ConfigurationError, RecordError, RigError
from rig.analysis import read_results
from rig.archive import add_sessions, blind_runs, list_runs, unseal
from rig.archive.blind import sealed
from rig.archive.columns import COLUMNS, PARAMETERS
from rig.archive.store import Archive
from rig.commands.fitting import fit_records
from rig.sealing import is_blind, seal_over
from tests.rig.archive.histories import killed_at
from tests.rig.command_line import CONFIGS, SMALL, rig, set_words

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"


@pytest.fixture
def archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    add_sessions(tmp_path / "archive", [tmp_path / "runs"])
    return tmp_path / "archive"


def row(archive: Path) -> dict[str, Any]:
    connection = Archive(archive).connection()
    found = connection.execute("select * from runs where run = 'run-1'")
    return dict(zip([item[0] for item in found.description], found.fetchone(), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("merged", [False, True])
def test_no_query_tells_a_hidden_value(archive: Path, merged: bool) -> None:
    if merged:
        Archive(archive).merge(at_once=1)
    true = row(archive)
    blind_runs(archive, [])
    told = row(archive)
    for name in PARAMETERS:
        assert true[name] is None or told[name] != true[name], name
        assert told[f"u_{name}"] == true[f"u_{name}"]
    # what follows from them, or tells them beside the duration
    for name in ("mean_period_s", "initial_amplitude", "final_amplitude", "half_cycles", "frames"):
        assert told[name] is None, name
    secret = {
        name: value for name, value in true.items() if isinstance(value, float) and told.get(name) != value
    }
    assert {"b", "c", "p", "period0_s", "mean_period_s"} <= secret.keys()
    connection = Archive(archive).connection()
    tables = {name for (name,) in connection.execute("select table_name from duckdb_tables()").fetchall()}
    views = connection.execute("select view_name from duckdb_views() where not internal").fetchall()
    assert (tables, views) == ({"runs", "versions", "latest"}, [])
    everything = [
        value
        for table in sorted(tables)
        for found in connection.execute(f"select * from {table}").fetchall()
        for value in found
    ]
    assert not set(secret.values()) & {value for value in everything if isinstance(value, float)}
    merged_file = next((archive / "merged").glob("*.parquet"), archive / "sessions")
    state = next((archive / "sessions").glob("*.parquet"))
    for tried in (
        "(select max(b) from open_runs)",
        "(select max(b) from all_rows)",
        "(select max(b) from every_row)",
        "(select max(b_offset) from hidden)",
        f"(select max(b) from read_parquet('{merged_file}'))",
        f"(select max(b) from read_parquet('{state}'))",
        "(select max(b) from loose_rows)",
        "getvariable('key')",
    ):
        with pytest.raises(RigError):
            list_runs(archive, "", [f"{tried} as tried where {tried} is not null"], "csv", None)
    unseal(archive, "commit 1234")
    assert row(archive) == true


def test_the_key_lies_elsewhere_and_without_it_nothing_is_shown(archive: Path, tmp_path: Path) -> None:
    said = blind_runs(archive, ["c"])
    (key,) = (tmp_path / "data").rglob("*.key")
    assert str(key) in said
    if os.name == "posix":
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
    secret = key.read_text()
    for path in archive.rglob("*"):
        assert path.is_dir() or secret.encode() not in path.read_bytes()
    assert row(archive)["c"] is not None
    said = rig("archive", "list", "--json", "--archive", archive).stdout
    assert all(json.loads(line)["blind"] for line in said.splitlines())
    key.rename(tmp_path / "safe")
    assert row(archive)["c"] is None
    listed = rig("archive", "list", "--archive", archive)
    assert "BLIND: the key is not here" in listed.stderr
    key.write_text("00" * 32)
    with pytest.raises(RigError, match="is not the key"):
        sealed(archive)


def test_it_is_sealed_before_the_first_fit_and_before_the_first_session(
    archive: Path, tmp_path: Path
) -> None:
    series = tmp_path / "runs" / "series"
    results = (series / "results.json").read_bytes()
    true = row(archive)
    (series / "results.json").unlink()
    for place in (tmp_path / "unfitted", tmp_path / "empty"):
        if place.name == "unfitted":
            add_sessions(place, [series])
        blind_runs(place, [])
        with pytest.raises(ConfigurationError, match="blind already"):
            blind_runs(place, [])
        (series / "results.json").write_bytes(results)
        add_sessions(place, [series])
        told = row(place)
        for name in ("b", "c", "period0_s"):
            assert told[name] is not None
            assert told[name] != true[name]
            assert 0.5 <= told[name] / true[name] <= 2.0
        (series / "results.json").unlink()


def test_a_seal_of_an_earlier_version_holds(archive: Path) -> None:
    folder = archive / "blind"
    folder.mkdir()
    true = row(archive)
    (folder / "20260101T000000.000000.sealed.json").write_text(
        json.dumps({"secret": "ab" * 32, "scales": {"c": 1e-9}})
    )
    told = row(archive)
    assert told["c"] != true["c"]
    assert set(COLUMNS) <= set(told)


def test_results_of_a_blind_record_kept_elsewhere_say_how_they_are_opened(
    archive: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "runs"
    blind_runs(archive, [], [folder])
    fit_records([folder / "series" / "run-1.mcap"], tmp_path / "elsewhere", ())
    unseal(archive, "the law")
    with pytest.raises(RecordError, match="lies outside the blind folder of its record"):
        read_results(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").rename(folder / "fit")
    assert read_results(folder / "fit").runs[0].fits["exact"].parameters["b"].value > 0


@pytest.mark.slow
def test_a_run_in_a_blind_folder_says_once_and_as_no_error_why_it_has_no_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    (tmp_path / "runs").mkdir()
    blind_runs(tmp_path / "archive", [], [tmp_path / "runs"])
    wanted = set_words({**SMALL, "session.max_duration_s": "70"})
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "runs" / "first", *wanted)
    assert done.returncode == 0, done.stderr
    said = [line for line in (done.stdout + done.stderr).splitlines() if "report" in line]
    assert said == ["the folder is blind: results are sealed, and a report needs rig archive unblind"]
    assert "rig: " not in done.stderr
    assert not list((tmp_path / "runs" / "first").glob("report*"))


def test_blinding_that_is_killed_leaves_no_folder_open_and_none_shut_for_good(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.delenv("RIG_ARCHIVE", raising=False)
    for begun in (False, True):
        for write in range(1, 9):
            base = tmp_path / f"{begun}-{write}"
            archive, runs = base / "archive", base / "runs"
            runs.mkdir(parents=True)
            if begun:
                # a further folder of an archive that is blind already
                (base / "first").mkdir()
                blind_runs(archive, ["c"], [base / "first"])
            with killed_at(write):
                blind_runs(archive, ["b"], [runs])
            seal, folder = sealed(archive), seal_over(runs)
            if not begun and seal is not None:
                assert folder is not None, "the archive is blind; the folder is fitted in the open"
            if folder is not None and seal is None:
                with pytest.raises(ConfigurationError, match="begun and not finished"):
                    unseal(archive, "too early")
            again = [] if folder is not None and not begun and seal is None else [runs]
            if seal is None or again:
                # it goes on with the key that it had, wherever it was
                said = blind_runs(archive, ["b"], again)
                assert "blind" in said or "hidden" in said
            completed, folder = sealed(archive), seal_over(runs)
            assert completed is not None
            assert completed.key is not None
            assert folder is not None
            assert folder.public_key == completed.public_key
            unseal(archive, "commit 1234")
            assert not is_blind(runs)


def test_a_folder_that_another_archive_has_sealed_is_refused_before_this_one_is_sealed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    (tmp_path / "runs").mkdir()
    blind_runs(tmp_path / "one", ["b"], [tmp_path / "runs"])
    with pytest.raises(ConfigurationError, match="is blind already"):
        blind_runs(tmp_path / "two", ["b"], [tmp_path / "runs"])
    assert sealed(tmp_path / "two") is None
    blind_runs(tmp_path / "two", ["b"])
