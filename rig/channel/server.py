"""A session's end of its loopback port: it answers and takes orders."""

import contextlib
import http.server
import json
import os
import secrets
import threading
import urllib.parse
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rig.channel.session_news import SessionNews
from rig.presentation import plain_values

CHANNEL_NAME = ".channel.json"
LOOPBACK = "127.0.0.1"
SERVER = "rig-session"
"""How a session calls itself in each answer."""
BEAT = "/beat"
"""Answered with nothing, at once."""
SPECTRA = "spectra"
"""Query of a history that has them, too."""
Orders = Mapping[str, Callable[[str], str]]
"""What may be ordered, by its first word, which is called with the rest; returns what was done, or raises
RigError."""


class Channel:
    """A context manager: while it is open, the file in the session's folder names port and key.

    `extra` is asked with each answer, for what only the devices know. A channel that cannot be opened is no
    reason not to measure: nobody then watches, which `problem` says.
    """

    def __init__(
        self,
        folder: Path,
        session_news: SessionNews,
        orders: Orders,
        extra: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        self._path = folder / CHANNEL_NAME
        self.session_news, self.orders, self.extra = session_news, orders, extra
        self.key = secrets.token_urlsafe(24)
        self.over = threading.Event()
        self._server: _Server | None = None
        self.problem = ""

    def __enter__(self) -> Self:
        try:
            self._server = _Server(self)
            port = self._server.server_address[1]
            _write(self._path, {"port": port, "key": self.key, "pid": os.getpid()})
        except OSError as error:
            self.problem = f"nobody can watch this session: {error}"
            if self._server is not None:
                self._server.server_close()
                self._server = None
            return self
        threading.Thread(target=self._server.serve_forever, args=(0.2,), name="channel", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._server is None:
            return
        # who is connected already would be answered for as long as the process fits what was measured
        self.over.set()
        with contextlib.suppress(OSError):
            self._path.unlink()
        self._server.shutdown()
        self._server.server_close()


class QuietServer(http.server.ThreadingHTTPServer):
    """A server in threads that writes nothing into the terminal."""

    request_queue_size = 64
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Who has gone is no event."""


class _Server(QuietServer):
    def __init__(self, channel: Channel) -> None:
        super().__init__((LOOPBACK, 0), _Handler)
        self.channel = channel


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = SERVER, ""
    timeout = 30.0
    server: _Server

    def do_GET(self) -> None:
        address, channel = urllib.parse.urlsplit(self.path), self.server.channel
        if not self._may_ask():
            return
        number = urllib.parse.parse_qs(address.query).get("after", ["0"])[0]
        after = int(number) if number.isdecimal() else 0
        if address.path == BEAT:
            self._answer(b"", "text/plain", http.HTTPStatus.NO_CONTENT)
        elif address.path == "/news":
            news = {**channel.session_news.news(after), **channel.extra()}
            self._answer(json.dumps(plain_values(news)).encode(), "application/json")
        elif address.path == "/history":
            told = plain_values(channel.session_news.history(spectra=address.query == SPECTRA))
            self._answer(json.dumps(told).encode(), "application/json")
        elif address.path == "/picture":
            frame = channel.session_news.picture(after)
            if frame is None:
                self._answer(b"", "text/plain", http.HTTPStatus.NO_CONTENT)
                return
            image = frame.image
            about = {
                "number": frame.number,
                "shape": image.shape,
                "dtype": str(image.dtype),
                "spot": list(frame.spot),
                "reference": None if frame.reference is None else list(frame.reference),
            }
            self._answer(image.tobytes(), "application/octet-stream", about=json.dumps(plain_values(about)))
        else:
            self.send_error(http.HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        if not self._may_ask():
            return
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        name, _, rest = body.decode(errors="replace").partition(" ")
        order = self.server.channel.orders.get(name)
        try:
            done = f"{name!r}: this session knows no such order" if order is None else order(rest)
            answer = {"ok": order is not None, "text": done}
        except Exception as error:
            # whatever it is, it is reported to who ordered, and ends no session
            answer = {"ok": False, "text": str(error) or type(error).__name__}
        self._answer(json.dumps(answer).encode(), "application/json")

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged."""

    def _may_ask(self) -> bool:
        channel, given = self.server.channel, self.headers.get("Authorization", "")
        is_over = channel.over.is_set()
        if not is_over and secrets.compare_digest(given.encode(), channel.key.encode()):
            return True
        self.close_connection = True
        self.send_error(http.HTTPStatus.GONE if is_over else http.HTTPStatus.FORBIDDEN)
        return False

    def _answer(
        self, data: bytes, kind: str, status: http.HTTPStatus = http.HTTPStatus.OK, about: str = ""
    ) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        if about:
            self.send_header("About", about)
        self.end_headers()
        self.wfile.write(data)


def _write(path: Path, values: Mapping[str, object]) -> None:
    """Replace the file as a whole, readable by this user only."""
    new = path.with_name(f"{path.name}.{os.getpid()}")
    with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        json.dump(values, file)
    new.replace(path)
