"""An archive on S3: a real server here on loopback, two computers that use it at once."""

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.archive.remote import opened, write_new
from tests.rig.command_line import rig

REASON = "no server of S3 here: pip install 'optical-pendulum-rig[test-remote]'"
OLDER = Path(__file__).resolve().parents[1] / "data" / "older"


@pytest.fixture
def url(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An empty archive in a bucket of a server on loopback."""
    fsspec = pytest.importorskip("fsspec", reason=REASON)
    pytest.importorskip("s3fs", reason=REASON)
    server = pytest.importorskip("moto.server", reason=REASON).ThreadedMotoServer(
        "127.0.0.1", port=0, verbose=False
    )
    server.start()
    host, port = server.get_host_and_port()
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "test")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    system = fsspec.filesystem("s3", skip_instance_cache=True)
    system.makedirs("laboratory", exist_ok=True)
    yield "s3://laboratory/friction"
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    server.stop()


def test_two_computers_use_one_archive(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def on(computer: str, *words: str | Path) -> str:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / computer))
        done = rig("archive", *words, "--archive", url)
        assert done.returncode == 0, done.stderr
        return done.stdout

    shutil.copytree(OLDER / "series", tmp_path / "runs" / "series")
    shutil.copytree(OLDER / "uncalibrated", tmp_path / "more" / "uncalibrated")
    assert on("one", "add", tmp_path / "runs").startswith("1 sessions added (2 runs)")
    assert on("two", "add", tmp_path / "runs", tmp_path / "more").startswith(
        "1 sessions added (1 runs), 1 known"
    )
    on("two", "tag", "good", "--where", "b > 0")
    listed = on("one", "list", "--columns", "sha256, b, tags", "--format", "json")
    assert listed.count("sha256") == 3
    assert "good" in listed
    # what a worker sends is there for all; what is there already stays
    write_new(url, "refits/0123-4567.json.zst", b"first")
    write_new(url, "refits/0123-4567.json.zst", b"second")
    for computer in ("one", "two"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / computer))
        with opened(url) as folder:
            assert (folder / "refits" / "0123-4567.json.zst").read_bytes() == b"first"
            assert len(list((folder / "sessions").iterdir())) == 2
    # taken away here by accident it is brought again; taken away there it goes here, too
    shutil.rmtree(folder / "sessions")
    with opened(url) as folder:
        assert len(list((folder / "sessions").iterdir())) == 2
    # what a killed command had not sent is sent by the next one
    (folder / "remarks" / "late.json").write_text('{"utc": "2026-11-22T00:00:00Z", "runs": []}')
    on("two", "list")
    assert "late.json" in {path.name for path in _files(url, tmp_path / "three", monkeypatch)}


def _files(url: str, cache: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    with opened(url) as folder:
        return list(folder.rglob("*"))


@pytest.mark.parametrize(("address", "said"), [("s4://laboratory/a", "s4"), ("s3://nowhere/a", "nowhere")])
def test_what_cannot_be_reached_is_said_in_a_line(
    url: str, address: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    done = rig("archive", "tag", "good", "--where", "b > 0", "--archive", address)
    assert done.returncode in (1, 2)
    # the server is in this process, and writes to stderr, too
    ours = [line for line in done.stderr.splitlines() if "HTTP/1.1" not in line]
    assert len(ours) == 1
    assert ours[0].startswith(f"rig: {address}: ")
    assert said in ours[0]


def test_without_fsspec_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    done = rig("archive", "list", "--archive", "s3://laboratory/friction")
    assert done.returncode == 2
    assert "pip install 'optical-pendulum-rig[remote]'" in done.stderr
    assert done.stderr.count("\n") == 1
