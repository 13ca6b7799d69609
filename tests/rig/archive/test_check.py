"""Every file of an archive proves itself: one bit that changed anywhere is named, and never believed."""

import contextlib
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from processing.errors import RigError
from rig.archive import add_sessions, blind_runs, remark
from rig.archive.checking import check_archive
from rig.archive.refits import Recipe, Task, code_identity, refit
from rig.archive.store import Archive

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"


def everything(archive: Path) -> str:
    """All that an archive says, as text, or the error that it says instead."""
    connection = Archive(archive).connection(refits=True)
    return "\n".join(
        str(connection.execute(f"select * from {table} order by all").fetchall())
        for table in ("runs", "versions", "refits")
    )


def make_archive(base: Path) -> Path:
    """An archive that holds files of every kind."""
    archive = base / "archive"
    for name in ("series", "uncalibrated"):
        shutil.copytree(SAMPLES / name, base / "runs" / name)
    # before all others: what lies open from before cannot be made again in a blind archive
    blind_runs(archive, ["b"])
    add_sessions(archive, [base / "runs" / "series"])
    add_sessions(archive, [base / "runs"])
    remark(archive, [], "run = 'run-1'", add="good")
    remark(archive, [], "run = 'run-1'", note="plate cleaned")
    # a record without a fit has a row, too, and takes no time
    recipe = Recipe("swings", (), (), code_identity())
    (without,) = (
        Archive(archive)
        .connection()
        .execute("select sha256 from runs where folder like '%uncalibrated'")
        .fetchone()
    )
    record = base / "runs" / "uncalibrated" / "run-1.mcap"
    assert refit(Task(str(archive), record, without, recipe, 1)) == ""
    Archive(archive).refits.merge(at_once=1)
    Archive(archive).merge(at_once=1)
    return archive


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made once; the key of what is hidden in it is lost."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data")))
        return make_archive(tmp_path_factory.mktemp("archive"))


@pytest.fixture
def archive(whole: Path, tmp_path: Path) -> Path:
    return shutil.copytree(whole, tmp_path / "archive")


def files(archive: Path) -> list[Path]:
    return sorted(path for path in archive.rglob("*") if path.is_file() and not path.name.startswith("."))


def flip(path: Path, place: int, bit: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1 << bit
    path.write_bytes(data)


def test_an_archive_as_it_was_written_is_proved(
    archive: Path, whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = {path.relative_to(archive).parts[0] for path in files(archive)}
    assert folders == {"archive.json", "facts", "sessions", "refits", "merged", "remarks", "blind"}
    assert check_archive(whole) == 0
    assert capsys.readouterr().out == f"{len(files(whole))} files verified, 0 damaged or missing\n"


def check_flips(archive: Path, per_file: int, seed: int) -> tuple[int, int, int]:
    """Flips in every file: how many, how many were believed, and how many `check` did not name."""
    random = np.random.default_rng(seed)
    said, count, believed, unnamed = everything(archive), 0, 0, 0
    for path in files(archive):
        before = path.read_bytes()
        for place in random.integers(0, len(before), per_file).tolist():
            flip(path, place, int(random.integers(8)))
            count += 1
            with contextlib.suppress(RigError):
                believed += everything(archive) != said
            unnamed += check_archive(archive) != 1
            path.write_bytes(before)
    return count, believed, unnamed


def test_no_flipped_bit_of_any_file_is_believed(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    count, believed, unnamed = check_flips(archive, 1, 3)
    assert (believed, unnamed) == (0, 0)
    said = capsys.readouterr().out
    for path in files(archive):
        assert f"{path.name}: " in said
    assert count == len(files(archive))


def test_what_follows_from_the_rest_is_repaired_and_what_does_not_is_named(
    archive: Path, whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = everything(archive)
    for path in files(archive):
        kind = path.relative_to(archive).parts[0]
        flip(path, path.stat().st_size // 2, 1)
        follows = kind in ("merged", "sessions", "refits")
        assert check_archive(archive, repair=True) == (0 if follows else 1), path
        assert path.name in capsys.readouterr().out
        shutil.rmtree(archive)
        shutil.copytree(whole, archive)
    state = files(archive / "sessions")[0]
    state.unlink()
    assert check_archive(archive) == 1
    assert f"{state}: is missing" in capsys.readouterr().out
    assert check_archive(archive, repair=True) == 0
    assert everything(archive) == said


def test_a_fact_that_was_rewritten_does_not_follow(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sound by itself, as somebody writes it who knows how."""
    from rig.archive.proved import with_line, without_line

    first = files(archive / "facts")[1]
    text = without_line(first, first.read_bytes()).decode()
    lines = text.split("\n")
    head = json.loads(lines[0])
    lines[0] = json.dumps({**head, "user": "somebody else"})
    first.write_bytes(with_line("\n".join(lines).encode()))
    assert check_archive(archive) == 1
    assert "does not follow from" in capsys.readouterr().out


def test_records_are_hashed_again_and_an_interrupted_check_goes_on(
    archive: Path, whole: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert check_archive(archive, records=True) == 0
    assert "; 3 records read, 0 not as" in capsys.readouterr().out
    import rig.archive.checking as checking

    hashed, looked = checking.measured_sha256_of, []

    def once(path: Path) -> str:
        looked.append(path)
        if len(looked) == 2:
            raise KeyboardInterrupt
        return hashed(path)

    monkeypatch.setattr(checking, "measured_sha256_of", once)
    with pytest.raises(KeyboardInterrupt):
        check_archive(archive, records=True)
    monkeypatch.undo()
    capsys.readouterr()
    assert check_archive(archive, records=True) == 0
    assert "; 2 records read, 0 not as" in capsys.readouterr().out
    record = whole.parent / "runs" / "series" / "run-1.mcap"
    found = record.stat()
    flip(record, found.st_size // 2, 0)
    os.utime(record, ns=(found.st_atime_ns, found.st_mtime_ns))
    assert check_archive(archive, records=True) == 1
    assert f"{record}: is not the record that was added" in capsys.readouterr().out
    flip(record, found.st_size // 2, 0)
    os.utime(record, ns=(found.st_atime_ns, found.st_mtime_ns))
