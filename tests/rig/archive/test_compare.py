"""`rig archive compare`, `blind`, `diff`, `view`: what runs say together, and what moved."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from processing.errors import ConfigurationError, RecordError
from rig.archive import add_sessions, blind_runs, compare_groups, unseal, view_runs
from rig.archive.blind import sealed
from rig.archive.facts import Fact
from rig.archive.proved import without_line
from rig.archive.store import Archive
from tests.rig.archive.test_refit import in_this_process
from tests.rig.command_line import rig

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"
TRUE = {"rig-1": 2.0, "rig-2": 2.1, "rig-3": 3.5, "rig-4": 1.9, "rig-5": 2.0, "rig-6": 2.1}


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """Six rigs with four runs each, the third of which is off."""
    random = np.random.default_rng(2)
    store = Archive(tmp_path / "archive")
    store.begin()
    for rig_name, c in TRUE.items():
        rows = [
            {
                "sha256": f"{rig_name}{run}".encode().hex().ljust(64, "0"),
                "session": rig_name,
                "run": f"run-{run}",
            }
            | {
                "host": rig_name,
                "folder": rig_name,
                "record": "run.mcap",
                "state": "whole",
                "version": rig_name,
            }
            | {"c": c + random.normal(0.0, 0.1), "u_c": 0.1, "u_total_c": 0.15}
            for run in range(4)
        ]
        state = store.sessions.write(rig_name, rows)
        store.log.write([Fact("here", rig_name, *state, "", "2026-11-22T00:00:00")])
    return tmp_path / "archive"


def values(archive: Path) -> dict[str, float]:
    done = rig("archive", "list", "--columns", "run, host, c", "--format", "json", "--archive", archive)
    return {f"{row['host']} {row['run']}": row["c"] for row in json.loads(done.stdout)}


def test_rigs_are_compared_and_the_one_that_is_off_is_named(archive: Path, tmp_path: Path) -> None:
    picture = tmp_path / "c.svg"
    done = rig("archive", "compare", "c", "-o", picture, "--archive", archive)
    assert done.returncode == 0, done.stderr
    lines = {line.split()[0]: line for line in done.stdout.splitlines() if line.split()}
    assert lines["rig-3"].endswith("differs")
    assert "rig-1" in lines
    assert "Mandel-Paule" in done.stdout
    assert "scatter more than they state" in done.stdout
    assert "differs" not in rig("archive", "compare", "c", "--by", "run", "--archive", archive).stdout
    assert picture.read_bytes().startswith(b"<?xml")
    for column, by, said in (
        ("host", "host", "no uncertainty"),
        ("c", "colour", "is not a column"),
        ("b", "host", "0 of its groups"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            compare_groups(archive, column, by, "", None)


@pytest.mark.slow
def test_blind_values_are_offset_by_rig_until_what_is_frozen_is_recorded(archive: Path) -> None:
    before = values(archive)
    said = blind_runs(archive, ["c"])
    hidden = values(archive)
    offsets = {name: hidden[name] - before[name] for name in before}
    by_rig = {host: {round(offsets[name], 9) for name in offsets if name.startswith(host)} for host in TRUE}
    assert all(len(found) == 1 for found in by_rig.values())
    assert len({min(found) for found in by_rig.values()}) == len(TRUE)
    assert values(archive) == hidden
    assert "BLIND" in rig("archive", "compare", "c", "--archive", archive).stdout
    with pytest.raises(ConfigurationError, match="blind already"):
        blind_runs(archive, ["c"])
    with pytest.raises(ConfigurationError, match="which analysis is frozen"):
        unseal(archive, " ")
    unseal(archive, "commit 1234, all cuts")
    assert values(archive) == before
    (opened,) = (archive / "blind").glob("*.opened.json")
    record = json.loads(without_line(opened, opened.read_bytes()))
    assert record["frozen"] == "commit 1234, all cuts"
    assert record["seal_sha256"] in said
    with pytest.raises(ConfigurationError, match="is not blind"):
        unseal(archive, "again")
    with pytest.raises(ConfigurationError, match="not a column with an uncertainty"):
        blind_runs(archive, ["sample"])
    (archive / "blind" / "20000101T000000.sealed.json").write_text("{}")
    with pytest.raises(RecordError, match="take it from a backup"):
        sealed(archive)


@pytest.mark.slow
def test_what_moved_is_named_with_its_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.archive.refitting.in_processes", in_this_process)
    archive = tmp_path / "archive"
    shutil.copytree(SAMPLES / "series", tmp_path / "runs")
    add_sessions(archive, [tmp_path / "runs"])
    assert "no run that is meant has two versions" in rig("archive", "diff", "--archive", archive).stderr
    whole = ("--where", "state = 'whole'", "--archive", archive)
    rig("archive", "refit", *whole)
    changes = ("--set", "lever.arm_m=0.9", "--set", "fit.robust=true", "--level", "spots")
    again = rig("archive", "refit", *changes, *whole)
    assert again.returncode == 0, again.stderr
    moved = rig("archive", "diff", *whole)
    assert moved.returncode == 0, moved.stderr
    assert "exact.b" in moved.stdout
    text = " ".join(moved.stdout.split())
    assert "configuration (fit.robust=true)" in text
    assert "calibration (lever.arm_m=0.9)" in text
    assert "code" not in text
    with pytest.raises(ConfigurationError, match="0 runs are meant"):
        view_runs(archive, [], "b < 0", "spawn", None)
    view_runs(archive, [], "state = 'whole'", "spawn", tmp_path / "runs.rrd")
    assert (tmp_path / "runs.rrd").stat().st_size > 10_000
