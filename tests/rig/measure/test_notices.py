"""Who is not there is told by a command and a webhook; they may hang, and nobody else learns the address."""

import json
import sys
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any

import pytest

from processing.errors import ConfigurationError
from rig.measure import notices
from rig.measure.notices import Notices
from rig.settings import SessionSettings
from tests.rig.command_line import CONFIGS, SMALL, rig, set_words

SECRET = "a-secret-of-the-address"
WAIT_S = 60.0


class Webhook:
    """A server that keeps what is posted, and answers `status` once `may_answer` is set."""

    def __init__(self, folder: Path) -> None:
        self.posted: SimpleQueue[tuple[str, dict[str, str]]] = SimpleQueue()
        self.may_answer = Event()
        self.may_answer.set()
        self.status = 204
        webhook = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                webhook.posted.put((self.path, body))
                webhook.may_answer.wait(WAIT_S)
                self.send_response(webhook.status)
                if webhook.status == 302:
                    self.send_header("Location", "/elsewhere")
                self.end_headers()

            def do_GET(self) -> None:
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.file = folder / "webhook"
        self.file.write_text(f"http://127.0.0.1:{self.server.server_address[1]}/hook?key={SECRET}\n")


@pytest.fixture
def webhook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Webhook]:
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    made = Webhook(tmp_path)
    serving = Thread(target=made.server.serve_forever, kwargs={"poll_interval": 0.05})
    serving.start()
    try:
        yield made
    finally:
        made.may_answer.set()
        made.server.shutdown()
        serving.join()
        made.server.server_close()


def program(folder: Path, text: str) -> str:
    """A command that appends its arguments to the file `told`."""
    path = folder / "tell.py"
    path.write_text(f"import json, sys, time\nopen({str(folder / 'told')!r}, 'a').write({text})\n")
    return str(path)


def test_the_failure_of_a_session_is_told_and_the_address_is_kept_nowhere(
    tmp_path: Path, webhook: Webhook
) -> None:
    command = [sys.executable, program(tmp_path, "json.dumps(sys.argv[1:]) + '\\n'")]
    told = {"session.notify_command": json.dumps(command), "session.notify_webhook_file": str(webhook.file)}
    short = {**SMALL, **told, "session.max_duration_s": "4"}
    out = tmp_path / "out"
    done = rig("run", CONFIGS / "demo.toml", "-o", out, *set_words(short))
    assert done.returncode == 1
    path, posted = webhook.posted.get(timeout=WAIT_S)
    assert path.endswith(SECRET)
    assert (posted["kind"], posted["folder"]) == ("failure", str(out))
    assert posted["utc"]
    # the cause, and not only that there is one
    assert "run-1.mcap: " in posted["text"]
    assert json.loads((tmp_path / "told").read_text()) == ["failure", posted["text"], str(out)]
    assert (out / "run-1.mcap").exists()
    for file in out.rglob("*.*"):
        assert SECRET.encode() not in file.read_bytes(), file
    assert SECRET not in done.stdout + done.stderr


def test_a_webhook_and_a_command_that_hang_delay_nothing(
    tmp_path: Path, webhook: Webhook, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(notices, "_CALL_S", 2.0)
    monkeypatch.setattr(notices, "_LAST_WAIT_S", 0.1)
    webhook.may_answer.clear()
    hanging = (sys.executable, program(tmp_path, "'begun'); time.sleep(600"))
    settings = SessionSettings(notify_command=hanging, notify_webhook_file=webhook.file)
    session_news = Notices(settings, tmp_path)
    session_news.tell("alarm", "the laser is dark")
    _, posted = webhook.posted.get(timeout=WAIT_S)
    session_news.wait()
    assert posted["text"] == "the laser is dark"
    # neither has answered, and this thread has come as far as here
    assert [thread.is_alive() for thread in session_news.calls] == [True, True]
    for thread in session_news.calls:
        thread.join(WAIT_S)
    said = capsys.readouterr().err
    assert "was ended after 2 s" in said
    assert "the webhook at 127.0.0.1 was not reached: TimeoutError" in said


def test_a_webhook_that_refuses_and_a_command_that_fails_are_said_without_the_address(
    tmp_path: Path, webhook: Webhook, capsys: pytest.CaptureFixture[str]
) -> None:
    webhook.status = 403
    settings = SessionSettings(
        notify_command=(str(tmp_path / "no-such-program"),), notify_webhook_file=webhook.file
    )
    session_news = Notices(settings, tmp_path)
    session_news.tell("end", "every run was measured")
    session_news.wait()
    said = capsys.readouterr().err
    assert "the webhook at 127.0.0.1 was not reached: HTTPError 403" in said
    assert "session.notify_command" in said
    assert "no-such-program" in said
    assert SECRET not in said


def test_a_webhook_that_has_moved_is_said(
    tmp_path: Path, webhook: Webhook, capsys: pytest.CaptureFixture[str]
) -> None:
    webhook.status = 302
    session_news = Notices(SessionSettings(notify_webhook_file=webhook.file), tmp_path)
    session_news.tell("alarm", "the laser is dark")
    session_news.wait()
    said = capsys.readouterr().err
    assert (
        "was not reached: HTTPError 302: it has moved, state where to in session.notify_webhook_file" in said
    )


def test_what_hangs_at_the_end_is_said(
    tmp_path: Path, webhook: Webhook, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(notices, "_LAST_WAIT_S", 0.1)
    webhook.may_answer.clear()
    session_news = Notices(SessionSettings(notify_webhook_file=webhook.file), tmp_path)
    session_news.tell("end", "every run was measured")
    webhook.posted.get(timeout=WAIT_S)
    session_news.wait()
    said = capsys.readouterr().err
    assert (
        "the webhook at 127.0.0.1 did not answer within 0.1 s: it is unknown whether the message arrived"
        in said
    )
    webhook.may_answer.set()
    for thread in session_news.calls:
        thread.join(WAIT_S)


@pytest.mark.parametrize("text", ["", f"ftp://host/{SECRET}", f"https://host/{SECRET} twice", "https:///"])
def test_an_address_that_is_none_is_refused_before_anything_is_lit(tmp_path: Path, text: str) -> None:
    file = tmp_path / "webhook"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match="must hold an address") as refused:
        Notices(SessionSettings(notify_webhook_file=file), tmp_path)
    assert SECRET not in str(refused.value)
    with pytest.raises(ConfigurationError, match="cannot be read: No such file"):
        Notices(SessionSettings(notify_webhook_file=tmp_path / "nowhere"), tmp_path)


def test_an_end_that_reached_nobody_is_told_again(tmp_path: Path, webhook: Webhook) -> None:
    """The network is away in the night: who starts the session again in the morning is told then."""
    webhook.status = 503
    told = {"session.notify_webhook_file": str(webhook.file)}
    out = tmp_path / "out"
    rig("run", CONFIGS / "demo.toml", "-o", out, *set_words({**SMALL, **told, "session.max_duration_s": "8"}))
    again = [webhook.posted.get(timeout=WAIT_S)[1]["text"]]
    for status in (204, 204):
        webhook.status = status
        rig("run", "--resume", out)
        while not webhook.posted.empty():
            again.append(webhook.posted.get()[1]["text"])
    # once in vain, once heard, and then no more
    assert len(again) == 2
    assert again[0].startswith("not every run was measured and fitted")
