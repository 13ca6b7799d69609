"""`rig archive thin`: pixels go by rule; all else, and whose measurement it is, stays as it was."""

import datetime
import json
import os
import shutil
from pathlib import Path

import pytest

from acquisition.record.check import check_record
from acquisition.record.digest import sha256_of
from acquisition.record.proof import Thinning, measured_sha256_of
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from acquisition.record.thin import thin
from processing.errors import ConfigurationError, RecordError
from rig.archive import add_sessions, remark, thin_runs
from rig.archive.store import Archive
from tests.rig.command_line import rig

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"
BEGUN = json.loads((SAMPLES / "series" / "session.json").read_text())["entries"][0]["begun_utc"]
LATER = datetime.date(int(BEGUN[:4]) + 1, int(BEGUN[5:7]), int(BEGUN[8:10]))
"""A year after the records of `SAMPLES`."""


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """An archive of a whole run with results, one that was cut short, and one in px without a fit."""
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    shutil.copytree(SAMPLES / "uncalibrated", tmp_path / "runs" / "uncalibrated")
    add_sessions(tmp_path / "archive", [tmp_path / "runs"])
    return tmp_path / "archive"


@pytest.fixture
def record(archive: Path) -> Path:
    return archive.parent / "runs" / "series" / "run-1.mcap"


def thinned(archive: Path, drop_after: int | None, recompress_after: int | None = None) -> int:
    rule = {"drop_after": drop_after, "recompress_after": recompress_after}
    return thin_runs(archive, [], "", **rule, agreed=lambda question: True, today=LATER)


def _numbers(reader: RecordReader) -> list[bytes]:
    """All spots and half-cycles, NaN included."""
    return [reader.table(topic).tobytes() for topic in ("/spot", "/swing")]


def rows(archive: Path) -> list[tuple[object, ...]]:
    columns = "sha256, session, state, windows, b, u_b, results, tags"
    found: list[tuple[object, ...]] = (
        Archive(archive).connection().execute(f"select {columns} from runs order by sha256").fetchall()
    )
    return found


@pytest.mark.slow
def test_windows_go_by_rule_and_the_record_stays_the_same_measurement(
    archive: Path, record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured, before = sha256_of(record), record.read_bytes()
    remark(archive, [measured[:8]], add="good")
    listed = rows(archive)
    with RecordReader(record) as reader:
        windows, numbers = list(reader.windows()), _numbers(reader)
    # not old enough by a day
    assert thinned(archive, 13) == 0
    assert record.read_bytes() == before
    # in fewer bytes first
    fewer = thin(record, tmp_path / "fewer.mcap", Thinning.RECOMPRESSED, {}, {})
    assert (fewer.measured_sha256, fewer.bytes < fewer.source_bytes) == (measured, True)
    with RecordReader(tmp_path / "fewer.mcap") as reader:
        assert all(
            (a.image == b.image).all() and (a[:2], a[3]) == (b[:2], b[3])
            for a, b in zip(windows, reader.windows(), strict=True)
        )
    shutil.copyfile(tmp_path / "fewer.mcap", record)
    assert sha256_of(record) != measured == measured_sha256_of(record)
    assert thinned(archive, 12, 6) == 1
    said_of_it = capsys.readouterr()
    assert "1 records thinned" in said_of_it.out
    assert "run-2.mcap: is cut short" in said_of_it.err
    with RecordReader(record) as reader:
        assert list(reader.windows()) == []
        assert _numbers(reader) == numbers
        places = reader.table("/window_place")
        assert [(w.sequence, *w.origin_px, *w.image.shape) for w in windows] == [
            (p["sequence"], p["x0_px"], p["y0_px"], p["height_px"], p["width_px"]) for p in places
        ]
        said = reader.metadata["thinned 2"]
        assert (said["measured_sha256"], said["window_count"]) == (measured, str(len(windows)))
        attached = [name for name in reader.attachments if name.startswith("thinned/")]
        assert json.loads(reader.attachments[attached[-1]])["runs"][0]["sha256"] == measured
    # the same run of the same session, with its results and its tag
    changed = {"recorded": "dropped"}
    assert {row[3] for row in listed} == {"recorded", "none", None}
    assert rows(archive) == [
        (*row[:3], changed[str(row[3])] if row[0] == measured else row[3], *row[4:]) for row in listed
    ]
    assert not [item for item in check_record(record, record.parent / "results.json") if item[0] == "error"]


@pytest.mark.slow
def test_a_thinned_record_is_read_by_every_command(archive: Path, record: Path, tmp_path: Path) -> None:
    replayed = [rig("replay", record).stdout]
    assert rig("archive", "thin", "--drop-after", "0", "--yes", "--archive", archive).returncode == 1
    replayed.append(rig("replay", record).stdout)
    assert replayed[0] == replayed[1]
    again = rig("replay", record, "--retrack").stderr
    assert "rig archive thin dropped them on" in again
    refused = rig(
        "archive", "refit", measured_sha256_of(record)[:8], "--level", "pixels", "--archive", archive
    )
    assert refused.returncode == 1
    crate = tmp_path / "crate"
    said = ("--title", "Thin", "--author", "Ada Example")
    published = rig("archive", "publish", "--where", "b > 0", "-o", crate, *said, "--archive", archive)
    assert published.returncode == 0, published.stderr
    assert rig("archive", "add", crate, "--archive", tmp_path / "other").stdout.startswith("1 session added")
    assert rows(tmp_path / "other")[0][0] == measured_sha256_of(record)
    # changed by a bit, or made of one that was damaged, it is no longer that measurement
    data = bytearray(record.read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "changed.mcap").write_bytes(data)
    assert measured_sha256_of(tmp_path / "changed.mcap") == sha256_of(tmp_path / "changed.mcap")
    recover(record, tmp_path / "recovered.mcap")
    assert measured_sha256_of(tmp_path / "recovered.mcap") == sha256_of(tmp_path / "recovered.mcap")


def test_nothing_is_thinned_without_results_consent_or_proof(
    archive: Path, record: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = record.read_bytes()
    words = ("archive", "thin", "--archive", archive)
    assert "state what to do and when" in rig(*words).stderr
    asked = rig(*words, "--drop-after", "0")
    assert (asked.returncode, "--yes" in asked.stderr) == (2, True)
    no = {"drop_after": 0, "recompress_after": None}
    assert thin_runs(archive, [], "", **no, agreed=lambda question: False, today=LATER) == 0
    assert "nothing was changed" in capsys.readouterr().out
    results = (record.parent / "results.json").read_bytes()
    (record.parent / "results.json").unlink()
    assert thinned(archive, 0) == 1
    assert "run-1.mcap: has no results" in capsys.readouterr().err
    (record.parent / "results.json").write_bytes(results)
    # a copy that does not hold what it should takes nobody's place
    monkeypatch.setattr("acquisition.record.thin.is_sound", lambda file, contents: file.name == "run-1")
    with pytest.raises(RecordError):
        thin(record, record.with_name("copy"), Thinning.DROPPED, {}, {})
    monkeypatch.undo()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert thinned(archive, 0) == 1
    assert record.read_bytes() == before
    assert sorted(path.name for path in record.parent.iterdir()) == sorted(os.listdir(SAMPLES / "series"))
    with pytest.raises(ConfigurationError, match="--drop-after MONTHS"):
        thinned(archive, None)
