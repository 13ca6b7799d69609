"""A file appears whole or not at all, with the rights of any other."""

import errno
import os
from pathlib import Path

import pytest

from acquisition import atomic_write

pytestmark = pytest.mark.skipif(os.name != "posix", reason="rights and symbolic links of POSIX")


def test_it_has_the_rights_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "usual").write_bytes(b"")
    atomic_write.replace(tmp_path / "new", b"data")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode
    assert (tmp_path / "new").read_bytes() == b"data"


def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    atomic_write.replace(tmp_path / "link", b"new")
    assert not (tmp_path / "link").is_symlink()
    assert (tmp_path / "link").read_bytes() == b"new"
    assert (tmp_path / "elsewhere").read_bytes() == b"old"


def test_a_full_disk_leaves_the_old_file_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "file").write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        atomic_write.replace(tmp_path / "file", b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_bytes() == b"old"


def test_what_is_not_finished_takes_no_name(tmp_path: Path) -> None:
    writing = atomic_write.atomic_file(tmp_path / "file")
    writing.__enter__().write_bytes(b"data")
    assert not writing.__exit__(ValueError, ValueError("no"), None)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_somebody_else_writes_meanwhile_stays(tmp_path: Path) -> None:
    path = tmp_path / "file"
    writing = atomic_write.atomic_file(path)
    writing.__enter__().write_bytes(b"mine")
    path.write_bytes(b"other")
    with pytest.raises(FileExistsError):
        writing.__exit__(None, None, None)
    with pytest.raises(FileExistsError):
        atomic_write.write_new(path, b"mine")
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"other", [path])


def test_what_a_kill_left_a_day_ago_is_taken_away_and_nothing_else(tmp_path: Path) -> None:
    for name in (".run-1.mcap.0123abcd", ".run-2.mcap.89abcdef", ".hidden", ".run-1.mcap.76543210"):
        (tmp_path / name).write_bytes(b"half")
        if not name.endswith("0"):
            os.utime(tmp_path / name, (0, 0))
    assert atomic_write.remove_leftovers(tmp_path, "run-1.mcap") == [tmp_path / "run-1.mcap"]
    (tmp_path / ".run-2.mcap.76543210").mkdir()
    atomic_write.write_new(tmp_path / "run-2.mcap", b"whole")
    left = [".hidden", ".run-1.mcap.76543210", ".run-2.mcap.76543210", "run-2.mcap"]
    assert sorted(path.name for path in tmp_path.iterdir()) == left


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "crate"
    with atomic_write.atomic_folder(path) as beside:
        (beside / "inner").mkdir()
        (beside / "inner" / "file").write_bytes(b"whole")
        assert not path.exists()
    assert (path / "inner" / "file").read_bytes() == b"whole"
    with pytest.raises(FileExistsError), atomic_write.atomic_folder(path):
        pass
    with pytest.raises(ValueError, match="not good"), atomic_write.atomic_folder(tmp_path / "other"):
        raise ValueError("not good")
    assert [entry.name for entry in tmp_path.iterdir()] == ["crate"]
