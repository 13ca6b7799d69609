"""A release is whole or none: what is built twice has the same bytes, and a refusal changes nothing."""

import importlib.util
import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.release import __main__ as command
from tests.release import files as built
from tests.release.files import build, digest, write_sums
from tests.release.refusals import Refused, git

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no git repository")
DAY = "2031-05-06"
NEW_PART = "# Changes\n\n## 9.8.7, not yet released\n\n- **Light**: brighter.\n\n"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A clone with the files of this tree, whose part of the changelog is 9.8.7."""
    return clone(tmp_path / "tree")


def clone(path: Path) -> Path:
    git(ROOT, "clone", "--quiet", "--shared", str(ROOT), str(path))
    for key, value in {"user.name": "A", "user.email": "a@example.org"}.items():
        git(path, "config", key, value)
    changelog = path / "CHANGELOG.md"
    text = changelog.read_text(encoding="utf-8").splitlines(keepends=True)
    rows = [row for row, line in enumerate(text) if line.endswith(", not yet released\n")]
    changelog.write_text(
        NEW_PART + "".join(text[max(rows, default=0) + 1 :]),
        encoding="utf-8",
    )
    git(path, "commit", "--quiet", "--all", "--message", "a change")
    return path


def state(tree: Path) -> tuple[str, str, str]:
    return git(tree, "rev-parse", "HEAD"), git(tree, "tag"), git(tree, "status", "--porcelain")


@pytest.mark.slow
def test_two_builds_have_the_same_bytes(tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = build(tree, tmp_path / "one")
    other_place = tmp_path / "a longer path" / "to it"
    before = os.umask(0o077)
    try:
        git(ROOT, "clone", "--quiet", "--no-hardlinks", str(tree), str(other_place))
        monkeypatch.setenv("TZ", "Pacific/Auckland")
        other = build(other_place, tmp_path / "other")
    finally:
        os.umask(before)
    assert [path.suffix for path in one] == [".whl", ".gz"]
    built.refuse_difference(one, other)
    with zipfile.ZipFile(one[0]) as wheel:
        assert {"rig/configs/demo.toml", "rig/record.md"} <= set(wheel.namelist())
    # an sdist makes the same wheel
    with tarfile.open(one[1]) as sdist:
        sdist.extractall(tmp_path / "sdist", filter="data")
    (unpacked,) = (tmp_path / "sdist").iterdir()
    epoch = {**os.environ, "SOURCE_DATE_EPOCH": built.committed_s(tree)}
    words = [sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path / "third"), "-t", "wheel"]
    subprocess.run(words, cwd=unpacked, env=epoch, check=True, capture_output=True)
    (third,) = (tmp_path / "third").iterdir()
    assert (third.name, digest(third)) == (one[0].name, digest(one[0]))
    one[0].write_bytes(one[0].read_bytes()[:-1])
    with pytest.raises(Refused, match="two builds of the same commit differ"):
        built.refuse_difference(one, other)


@pytest.fixture
def makers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the site, which make docs checks, and without the SBOM where its maker is not installed."""
    monkeypatch.setattr(command, "site", lambda tree, path: path.write_bytes(b"site"))
    if importlib.util.find_spec("cyclonedx_py") is None:
        monkeypatch.setattr(command, "refuse_what_is_missing", lambda tree: None)
        monkeypatch.setattr(command, "bill_of_materials", lambda tree, version, path: path.write_text("{}"))


@pytest.mark.usefixtures("makers")
@pytest.mark.parametrize(
    ("version", "reason"),
    [
        ("9.8", "three numbers"),
        ("9.8.6", "needs one part '## 9.8.6, not yet released'; it has 9.8.7"),
        ("9.8.7", "make-it-fail: failed"),
    ],
)
def test_a_refusal_changes_nothing(version: str, reason: str, tree: Path) -> None:
    before = state(tree)
    check = [sys.executable, "-c", "raise SystemExit(1)", "make-it-fail"]
    with pytest.raises(Refused, match=reason):
        command.release(tree, version, [check], DAY)
    assert state(tree) == before
    assert not (tree / "dist").exists()


def test_a_dirty_tree_and_a_tag_that_exists_are_refused(tree: Path) -> None:
    (tree / "new.txt").write_text("x")
    with pytest.raises(Refused, match=r"1 changes are not committed, the first: \?\? new.txt"):
        command.release(tree, "9.8.7", [], DAY)
    (tree / "new.txt").unlink()
    git(tree, "tag", "v9.8.7")
    with pytest.raises(Refused, match=r"v9\.8\.7: the tag exists"):
        command.release(tree, "9.8.7", [], DAY)
    git(tree, "tag", "--delete", "v9.8.7")
    git(tree, "tag", "v10.0.0")
    with pytest.raises(Refused, match=r"10\.0\.0 is released already"):
        command.release(tree, "9.8.7", [], DAY)


def test_what_is_missing_is_said_before_the_checks(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check = [sys.executable, "-c", "raise SystemExit(1)"]
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(Refused, match="needs cyclonedx-bom"):
        command.release(tree, "9.8.7", [check], DAY)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: find_spec("json"))
    git(tree, "config", "user.name", "")
    git(tree, "config", "--unset", "user.email")
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", os.devnull)
    with pytest.raises(Refused, match=r"git knows no user\.email, who releases: git config user\.email"):
        command.release(tree, "9.8.7", [check], DAY)
    assert not git(tree, "tag")


@pytest.mark.usefixtures("makers")
def test_a_failure_at_the_end_leaves_nothing(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody commits while the files are built; or the disk is full when they are handed over."""
    kept = command.shutil.copytree

    def quick(clone: Path, folder: Path) -> list[Path]:
        folder.mkdir()
        (folder / "optical_pendulum_rig-9.8.7.tar.gz").write_bytes(b"sdist")
        return list(folder.iterdir())

    def full(source: Path, target: Path) -> None:
        kept(source, target)
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr(command, "build", quick)
    monkeypatch.setattr(command.shutil, "copytree", full)
    before = state(tree)
    with pytest.raises(OSError, match="No space left"):
        command.release(tree, "9.8.7", [], DAY)
    assert state(tree) == before
    assert not list((tree / "dist").iterdir())
    monkeypatch.setattr(command.shutil, "copytree", kept)

    def commit(folder: Path) -> None:
        git(tree, "commit", "--quiet", "--allow-empty", "--message", "meanwhile")
        write_sums(folder)

    monkeypatch.setattr(command, "write_sums", commit)
    with pytest.raises(Refused, match="git merge: "):
        command.release(tree, "9.8.7", [], DAY)
    assert git(tree, "log", "-1", "--format=%s") == "meanwhile"
    assert git(tree, "tag") == before[1]
    assert not list((tree / "dist").iterdir())


@pytest.mark.slow
@pytest.mark.usefixtures("makers")
def test_a_release_has_all_its_files(tree: Path) -> None:
    folder = command.release(tree, "9.8.7", [[sys.executable, "-c", ""]], DAY)
    names = {path.name for path in folder.iterdir()}
    stem = "optical_pendulum_rig-9.8.7"
    assert names == {
        f"{stem}-py3-none-any.whl", f"{stem}.tar.gz", f"{stem}.cdx.json", f"{stem}-site.tar.gz", "SHA256SUMS",
    }  # fmt: skip
    sums = dict(reversed(line.split("  ")) for line in (folder / "SHA256SUMS").read_text().splitlines())
    assert sums == {name: digest(folder / name) for name in names - {"SHA256SUMS"}}
    assert git(tree, "describe", "--exact-match") == "v9.8.7"
    assert f"## 9.8.7, {DAY}\n" in (tree / "CHANGELOG.md").read_text(encoding="utf-8")
    assert "- **Light**: brighter." in git(tree, "tag", "--list", "--format=%(contents)", "v9.8.7")
    assert git(tree, "status", "--porcelain") == ""
    assert write_sums(folder).read_text().count("\n") == len(sums)
