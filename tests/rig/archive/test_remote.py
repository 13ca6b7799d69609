"""An archive on S3: a real server here on loopback, two computers that use it at once."""

import contextlib
import http.client
import http.server
import os
import shutil
import sys
import threading
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.archive import add_sessions
from rig.archive.proved import with_frame
from rig.archive.remote import brought, opened, write_new
from tests.rig.command_line import Done, rig

REASON = "no server of S3 here: pip install 'optical-pendulum-rig[test-remote]'"
SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"


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
    # the server's memory is that of this process, and outlives it
    system.rm("laboratory", recursive=True)
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    server.stop()


@pytest.mark.slow
def test_two_computers_use_one_archive(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def on(computer: str, *words: str | Path) -> str:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / computer))
        done = rig("archive", *words, "--archive", url)
        assert done.returncode == 0, done.stderr
        return done.stdout

    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    shutil.copytree(SAMPLES / "uncalibrated", tmp_path / "more" / "uncalibrated")
    assert on("one", "add", tmp_path / "runs").startswith("1 session added (2 runs)")
    assert on("two", "add", tmp_path / "runs", tmp_path / "more").startswith(
        "1 session added (1 run), 1 known"
    )
    on("two", "tag", "good", "--where", "b > 0")
    listed = on("one", "list", "--columns", "sha256, b, tags", "--format", "json")
    assert listed.count("sha256") == 3
    assert "good" in listed
    # what a worker sends is there for all; what is there already stays
    write_new(url, "refits/0123-4567.json.zst", with_frame(b"first"))
    write_new(url, "refits/0123-4567.json.zst", with_frame(b"second"))
    for computer in ("one", "two"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / computer))
        with opened(url) as folder:
            assert (folder / "refits" / "0123-4567.json.zst").read_bytes() == with_frame(b"first")
            assert len(list((folder / "sessions").iterdir())) == 2
    # taken away here by accident it is brought again
    shutil.rmtree(folder / "sessions")
    with opened(url) as folder:
        assert len(list((folder / "sessions").iterdir())) == 2
    # what a killed command had not sent is sent by the next one
    (folder / "remarks" / "late.json").write_text('{"utc": "2026-11-22T00:00:00Z", "runs": []}')
    on("two", "list")
    assert "late.json" in {path.name for path in _files(url, tmp_path / "three", monkeypatch)}


def test_what_a_killed_command_leaves_in_the_copy_goes(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with opened(url) as folder:
        (folder / "sessions").mkdir()
    # of what was brought, and of the list of what was seen
    left = [folder / "..seen.0d7e33ab", folder / "sessions" / ".a.parquet.0d7e33ab"]
    for path in left:
        path.touch()
    with opened(url):
        assert not any(path.exists() for path in left)


def on(monkeypatch: pytest.MonkeyPatch, cache: Path, url: str, *words: str | Path) -> Done:
    """A command of one user, whose copy of the archive lies in a cache of his own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    return rig("archive", *words, "--archive", url)


def bucket() -> Any:
    """What lies in the bucket, seen past the program."""
    import fsspec

    system = fsspec.filesystem("s3")
    system.invalidate_cache()
    return system


@pytest.mark.slow
def test_an_emptied_bucket_is_a_refusal_and_takes_nothing_away_here(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    cache = tmp_path / "one"
    for words in (("add", tmp_path / "runs"), ("tag", "good", "--where", "b > 0")):
        assert on(monkeypatch, cache, url, *words).returncode == 0
    copied = {path: path.read_bytes() for path in cache.rglob("*") if path.is_file()}
    remarks = bucket().find("laboratory/friction/remarks")
    kept = {path: bucket().cat_file(path) for path in bucket().find("laboratory/friction")}
    # what follows from nothing else and is gone there is sent again
    bucket().rm_file(remarks[0])
    done = on(monkeypatch, cache, url, "list")
    assert done.returncode == 0
    assert "1 files are gone there, the first is remarks/" in done.stderr
    assert bucket().cat_file(remarks[0]) == kept[remarks[0]]
    # all is gone, or the address leads to another bucket
    bucket().rm("laboratory/friction", recursive=True)
    for words in (("list",), ("add", tmp_path / "runs"), ("tag", "bad", "--where", "b > 0")):
        done = on(monkeypatch, cache, url, *words)
        assert done.returncode == 1
        assert "the archive that was there is gone (archive.json is missing)" in done.stderr
        assert bucket().find("laboratory/friction") == []
        assert {path: path.read_bytes() for path in cache.rglob("*") if path.is_file()} == copied
    # another archive in its place
    assert on(monkeypatch, tmp_path / "two", url, "add", tmp_path / "runs").returncode == 0
    done = on(monkeypatch, cache, url, "list")
    assert "holds another archive" in done.stderr
    assert not [path for path in bucket().find("laboratory/friction") if "remarks" in path]
    # put back from a copy of the bucket, all is as it was
    bucket().rm("laboratory/friction", recursive=True)
    for path, data in kept.items():
        bucket().pipe_file(path, data)
    assert "good" in on(monkeypatch, cache, url, "list", "--columns", "tags", "--format", "json").stdout


def test_what_was_altered_where_it_lies_is_named_and_not_believed(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    for words in (("add", tmp_path / "runs"), ("tag", "good", "--where", "b > 0")):
        assert on(monkeypatch, tmp_path / "one", url, *words).returncode == 0
    for number, path in enumerate(bucket().find("laboratory/friction")):
        data = bucket().cat_file(path)
        place = len(data) // 2
        bucket().pipe_file(path, data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :])
        done = on(monkeypatch, tmp_path / f"reader-{number}", url, "list")
        assert done.returncode == 1
        assert f"{path.rpartition('/')[2]}: its bytes have changed" in done.stderr
        bucket().pipe_file(path, data)


@pytest.mark.slow
def test_two_users_of_one_computer_tell_one_history(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second has not seen what the first sent while he worked: his facts come after, renumbered."""
    series = shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    other = shutil.copytree(SAMPLES / "uncalibrated", tmp_path / "more" / "uncalibrated")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "two"))
    with opened(url) as folder:
        add_sessions(folder, [series.parent])
        assert on(monkeypatch, tmp_path / "one", url, "add", other.parent).returncode == 0
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "two"))
    for user in ("one", "two", "three"):
        done = on(monkeypatch, tmp_path / user, url, "list", "--columns", "run", "--format", "json")
        assert (done.returncode, done.stdout.count("run-")) == (0, 3), done.stderr
    numbers = [path.rpartition("-")[2] for path in bucket().find("laboratory/friction/facts")]
    assert numbers == [f"{number:08d}.facts" for number in range(1, len(numbers) + 1)]


def _files(url: str, cache: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    with opened(url) as folder:
        return list(folder.rglob("*"))


class Lying(http.server.BaseHTTPRequestHandler):
    """Hands on what is asked to the server behind it, and lies as it is told."""

    protocol_version = "HTTP/1.1"
    behind: tuple[str, int]
    lie = ""

    def _answer(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        body, is_put = self.rfile.read(length), self.command == "PUT"
        if is_put and self.lie == "takes and keeps nothing" and "/remarks/" in self.path:
            status, headers, data = 200, [("ETag", '"0"')], b""
        else:
            if is_put and self.lie == "keeps another bit" and "/remarks/" in self.path:
                body = body[:9] + bytes([body[9] ^ 1]) + body[10:]
            server = http.client.HTTPConnection(*self.behind)
            # a checksum of what it was sent would give the lie away to the server behind
            kept = {
                name: value
                for name, value in self.headers.items()
                if not name.lower().startswith(("x-amz-checksum", "content-md5"))
                and (self.lie != "writes over" or name.lower() != "if-none-match")
            }
            server.request(self.command, self.path, body, kept)
            answer = server.getresponse()
            status, headers, data = answer.status, answer.getheaders(), answer.read()
            server.close()
            if self.command == "GET" and self.lie == "gives half" and ".parquet" in self.path:
                data = data[: len(data) // 2]
        self.send_response(status)
        for name, value in headers:
            if name.lower() not in (
                "content-length",
                "transfer-encoding",
                "connection",
                "server",
                "date",
            ) and (self.lie == "" or not name.lower().startswith("x-amz-checksum")):
                self.send_header(name, value)
        size = {name.lower(): value for name, value in headers}.get("content-length", "0")
        self.send_header("Content-Length", size if self.command == "HEAD" else str(len(data)))
        self.end_headers()
        self.wfile.write(b"" if self.command == "HEAD" else data)

    do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = _answer

    def log_message(self, *_: object) -> None:
        pass


@pytest.mark.slow
@pytest.mark.parametrize("lie", ["takes and keeps nothing", "keeps another bit", "gives half"])
def test_an_endpoint_that_lies_is_not_believed(
    url: str, lie: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    true = os.environ["AWS_ENDPOINT_URL"]
    assert on(monkeypatch, tmp_path / "one", url, "add", tmp_path / "runs").returncode == 0
    user = tmp_path / ("two" if lie == "gives half" else "one")
    with lying(lie, monkeypatch):
        done = on(monkeypatch, user, url, "tag", "good", "--where", "b > 0")
    assert done.returncode == 1, done.stdout
    assert lie != "gives half" or "sessions/" in done.stderr
    # what was said and not kept is not lost: it is here, and is sent to a server that keeps it
    assert os.environ["AWS_ENDPOINT_URL"] == true
    if lie == "keeps another bit":
        assert on(monkeypatch, user, url, "check", "--repair").returncode == 0
    elif lie == "gives half":
        assert on(monkeypatch, user, url, "tag", "good", "--where", "b > 0").returncode == 0
    assert on(monkeypatch, user, url, "list").returncode == 0
    listed = on(monkeypatch, tmp_path / "three", url, "list", "--columns", "tags", "--format", "json")
    assert "good" in listed.stdout


@contextlib.contextmanager
def lying(lie: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Between the program and the server somebody who lies so."""
    true = os.environ["AWS_ENDPOINT_URL"]
    address = urllib.parse.urlsplit(true)
    handler = type("Handler", (Lying,), {"behind": (address.hostname, address.port), "lie": lie})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.server_port}")
    fsspec_forgets()
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        monkeypatch.setenv("AWS_ENDPOINT_URL", true)
        fsspec_forgets()


@pytest.mark.slow
def test_a_server_that_writes_over_what_is_there_is_said_and_loses_nothing_sent_before(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    series = shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    other = shutil.copytree(SAMPLES / "uncalibrated", tmp_path / "more" / "uncalibrated")
    with lying("writes over", monkeypatch):
        assert on(monkeypatch, tmp_path / "three", url, "add", series.parent).returncode == 0
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "two"))
        # two users of one computer: the same names of facts, sent one after the other
        with opened(url) as folder:
            (series / "results.json").unlink()
            add_sessions(folder, [series.parent])
            done = on(monkeypatch, tmp_path / "one", url, "add", other.parent)
            assert "overwrites files although asked not to" in done.stderr
            monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "two"))
    for user in ("one", "two", "three", "four"):
        done = on(monkeypatch, tmp_path / user, url, "list", "--columns", "run", "--format", "json")
        assert (done.returncode, done.stdout.count("run-")) == (0, 3), done.stderr


def fsspec_forgets() -> None:
    import fsspec

    fsspec.get_filesystem_class("s3").clear_instance_cache()


def test_refused_credentials_are_said_and_nothing_is_lost(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    assert on(monkeypatch, tmp_path / "one", url, "add", tmp_path / "runs").returncode == 0
    kept = {path: path.read_bytes() for path in (tmp_path / "one").rglob("*") if path.is_file()}
    # the server's own: from the first call on it wants a key that it knows
    from moto import settings
    from moto.core.responses import ActionAuthenticatorMixin

    def authorised(after: float) -> None:
        settings.INITIAL_NO_AUTH_ACTION_COUNT = after
        ActionAuthenticatorMixin.request_count = 0

    authorised(0)
    fsspec_forgets()
    try:
        for words in (("list",), ("add", tmp_path / "runs"), ("check",)):
            done = on(monkeypatch, tmp_path / "one", url, *words)
            ours = [line for line in done.stderr.splitlines() if "HTTP/1.1" not in line]
            assert done.returncode == 1, words
            assert len(ours) == 1, ours
            assert "Access" in ours[0] or "Forbidden" in ours[0] or "denied" in ours[0].lower(), ours
    finally:
        authorised(float("inf"))
        fsspec_forgets()
    assert {path: path.read_bytes() for path in (tmp_path / "one").rglob("*") if path.is_file()} == kept
    assert on(monkeypatch, tmp_path / "one", url, "list").returncode == 0


def test_an_upload_that_was_cut_is_no_file(url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    assert on(monkeypatch, tmp_path / "one", url, "add", tmp_path / "runs").returncode == 0
    (fact, *_) = bucket().find("laboratory/friction/sessions")
    data = bucket().cat_file(fact)
    bucket().rm_file(fact)
    key = fact.removeprefix("laboratory/")
    begun = bucket().call_s3("create_multipart_upload", Bucket="laboratory", Key=key)
    part = {"Bucket": "laboratory", "Key": key, "UploadId": begun["UploadId"], "PartNumber": 1}
    bucket().call_s3("upload_part", **part, Body=data[:100])
    assert not bucket().exists(fact)
    done = on(monkeypatch, tmp_path / "two", url, "list")
    assert (done.returncode, "is missing" in done.stderr) == (1, True)
    # who has it sends it again
    assert on(monkeypatch, tmp_path / "one", url, "list").returncode == 0
    assert bucket().cat_file(fact) == data
    assert on(monkeypatch, tmp_path / "two", url, "list").returncode == 0


@pytest.mark.slow
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


@pytest.mark.slow
def test_two_histories_of_one_computer_are_a_refusal(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bucket is put back from a backup, and a computer that has lost its copy goes on there."""
    for name in ("series", "uncalibrated"):
        shutil.copytree(SAMPLES / name, tmp_path / "runs" / name)
    one, two = tmp_path / "one", tmp_path / "two"
    assert on(monkeypatch, one, url, "add", tmp_path / "runs").returncode == 0
    backup = {path: bucket().cat_file(path) for path in bucket().find("laboratory/friction")}
    (tmp_path / "runs" / "series" / "results.json").rename(tmp_path / "withdrawn.json")
    assert on(monkeypatch, one, url, "add", tmp_path / "runs").returncode == 0
    assert on(monkeypatch, two, url, "list").returncode == 0
    bucket().rm("laboratory/friction", recursive=True)
    for path, data in backup.items():
        bucket().pipe_file(path, data)
    shutil.rmtree(one)
    (tmp_path / "runs" / "uncalibrated" / "results.json").unlink()
    assert on(monkeypatch, one, url, "add", tmp_path / "runs" / "uncalibrated").returncode == 0
    for words in (("list",), ("add", tmp_path / "runs")):
        done = on(monkeypatch, two, url, *words)
        assert done.returncode != 0
        assert "differs from the copy here" in done.stderr
        assert str(two) in done.stderr
    # as the error says
    shutil.rmtree(two)
    assert on(monkeypatch, two, url, "add", tmp_path / "runs").returncode == 0
    lists = [on(monkeypatch, copy, url, "list", "order by sha256").stdout for copy in (one, two)]
    assert lists[0] == lists[1]


def test_an_empty_remote_archive_is_named_as_it_was_given(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = on(monkeypatch, tmp_path / "one", url, "list")
    assert done.returncode == 2
    assert f"rig archive add --archive {url} DIR" in done.stderr
    assert str(tmp_path) not in done.stderr


def test_the_desk_lists_an_archive_on_a_server_and_sends_nothing(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")
    from rig.desk.archived import Archived

    archived = Archived(url)
    assert archived.is_there
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    assert on(monkeypatch, tmp_path / "one", url, "add", tmp_path / "runs").returncode == 0
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "two"))
    found = archived.find("series", 0, 15)
    assert (found.found, len(found.rows)) == (2, 2)
    assert archived.find("nobody", 0, 15).found == 0
    # what lies in the copy only is not the desk's to send
    before = set(bucket().find("laboratory"))
    (brought(url) / "remarks").mkdir(exist_ok=True)
    (brought(url) / "remarks" / "late.json").write_text('{"utc": "2026-11-22T00:00:00Z", "runs": []}')
    Archived(url).find("", 0, 15)
    assert set(bucket().find("laboratory")) == before
    assert Archived("").is_there is Archived(str(tmp_path / "none")).is_there is False
