"""Both ends of a session's loopback port: it answers and takes orders, a desk asks and orders."""

import contextlib
import http.client
import http.server
import json
import os
import secrets
import threading
import urllib.parse
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from acquisition.frame import Image
from processing.errors import RigError
from processing.spot import Spot
from rig.channel import secret
from rig.channel.few_connections import FewConnections
from rig.channel.session_news import SessionNews
from rig.presentation import plain_values

CHANNEL_NAME = ".channel.json"
LOOPBACK = "127.0.0.1"
WHO = "/who"
"""Asked before anything else: a challenge, which only the session of the file can answer."""
SPECTRA = "spectra"
"""Query of a history that has them, too."""
_MOST_ASKED_BYTES = 64 * 1024
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


class _Server(FewConnections):
    def __init__(self, channel: Channel) -> None:
        super().__init__((LOOPBACK, 0), _Handler)
        self.channel = channel


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = 30.0
    server: _Server

    def setup(self) -> None:
        super().setup()
        # of this connection: a proof that was made for another one fits nothing here
        self._challenge, self._asked = secret.challenge(), 0

    def do_GET(self) -> None:
        address, channel = urllib.parse.urlsplit(self.path), self.server.channel
        if address.path == WHO:
            proof = secret.answer(channel.key, address.query)
            self._answer(
                json.dumps({"proof": proof, "challenge": self._challenge}).encode(), "application/json"
            )
            return
        if not self._may_ask(b""):
            return
        number = urllib.parse.parse_qs(address.query).get("after", ["0"])[0]
        after = int(number) if number.isdecimal() else 0
        if address.path == "/news":
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
        stated = self.headers.get("Content-Length") or "0"
        length = int(stated) if stated.isdecimal() else -1
        if not 0 <= length <= _MOST_ASKED_BYTES:
            self.close_connection = True
            return
        body = self.rfile.read(length)
        if not self._may_ask(body):
            return
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

    def _may_ask(self, body: bytes) -> bool:
        channel, given = self.server.channel, self.headers.get("Authorization", "")
        self._asked += 1
        asked = f"{self.command} {self.path}"
        wanted = secret.request_proof(channel.key, self._challenge, self._asked, asked, body)
        if not channel.over.is_set() and secret.fits(given, wanted):
            self.server.proved(self.connection)
            return True
        self.close_connection = True
        self.send_error(http.HTTPStatus.GONE if channel.over.is_set() else http.HTTPStatus.FORBIDDEN)
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


_ANSWER_S = 3.0
_ORDER_S = 20.0
_KINDS = {"uint8": np.uint8, "uint16": np.uint16}


class NoSession(RigError):
    """No session runs in this folder, or it does not answer."""


class SessionBusy(NoSession):
    """A session is connected, or its connection is being made, but it does not answer in time."""


class SessionPicture(NamedTuple):
    """A frame (ny, nx) in DN, the spot in it, and the reference's where it has one."""

    image: Image
    spot: Spot
    number: int
    reference: Spot | None = None


class Stranger(NoSession):
    """Another program answers at the port of a session that has ended."""


class Line:
    """Connected to the session that runs in a folder. May be used from any thread, by one at a time.

    Raises NoSession, as every method does, where nobody answers; SessionBusy if somebody may do so later;
    Stranger if who answers does not know the session's secret, which is told nothing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            stated = json.loads((folder / CHANNEL_NAME).read_text(encoding="ascii"))
            port, self._key, self.pid = int(stated["port"]), str(stated["key"]), int(stated["pid"])
        except (OSError, ValueError, KeyError, TypeError):
            raise NoSession(f"{folder}: no session runs here") from None
        self._connection = http.client.HTTPConnection(LOOPBACK, port, timeout=_ANSWER_S)
        self._challenge, self._number = "", 0
        self._was_seen = False
        self._one_at_a_time = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._connection.close()

    @property
    def process_lives(self) -> bool:
        """False once the process is gone that was there when it first answered; its port may be another's."""
        return not (self._was_seen and not _lives(self.pid))

    @property
    def process(self) -> int | None:
        """Number of the process that has answered; None before."""
        return self.pid if self._was_seen else None

    def beat(self) -> None:
        """Return once the session has answered at all; for that it waits for nothing, and makes nothing."""
        with self._one_at_a_time:
            try:
                self._meet(self._connection)
            except (OSError, http.client.HTTPException) as error:
                self._connection.close()
                raise self._unanswered(error) from None

    def news(self, after: int = 0) -> dict[str, Any]:
        """What `SessionNews.news` says."""
        _, _, data = self._ask("GET", f"/news?after={after}")
        found: dict[str, Any] = json.loads(data)
        return found

    def history(self, *, spectra: bool = True) -> dict[str, Any]:
        """What `SessionNews.history` says."""
        _, _, data = self._ask("GET", f"/history?{SPECTRA}" if spectra else "/history")
        found: dict[str, Any] = json.loads(data)
        return found

    def picture(self, after: int = 0) -> SessionPicture | None:
        """The newest frame if it is newer than `after`; asks for the next one, too."""
        status, about, data = self._ask("GET", f"/picture?after={after}")
        if status == http.HTTPStatus.NO_CONTENT:
            return None
        stated = json.loads(about)
        image = np.frombuffer(data, _KINDS[stated["dtype"]]).reshape(stated["shape"])
        reference = None if stated.get("reference") is None else _spot(stated["reference"])
        return SessionPicture(image, _spot(stated["spot"]), int(stated["number"]), reference)

    def order(self, name: str) -> str:
        """Carry out an order; returns what was done. Raises RigError with the reason if it was not."""
        _, _, data = self._ask("POST", "/order", name)
        answer = json.loads(data)
        if not answer["ok"]:
            raise RigError(str(answer["text"]))
        return str(answer["text"])

    def _ask(self, method: str, path: str, body: str | None = None) -> tuple[int, str, bytes]:
        with self._one_at_a_time:
            connection = self._connection
            try:
                if connection.sock is None:
                    self._meet(connection)
                self._number += 1
                data = (body or "").encode()
                proof = secret.request_proof(
                    self._key, self._challenge, self._number, f"{method} {path}", data
                )
                connection.request(method, path, data if body is not None else None, {"Authorization": proof})
                if connection.sock is not None:
                    connection.sock.settimeout(_ORDER_S if method == "POST" else _ANSWER_S)
                answer = connection.getresponse()
                data = answer.read()
            except (OSError, http.client.HTTPException) as error:
                connection.close()
                raise self._unanswered(error) from None
        if answer.status not in (http.HTTPStatus.OK, http.HTTPStatus.NO_CONTENT):
            raise NoSession(f"{self.folder}: its session refused to answer ({answer.status})")
        return answer.status, answer.getheader("About") or "", data

    def _unanswered(self, error: Exception) -> NoSession:
        why = f"{self.folder}: its session does not answer: {error}"
        return SessionBusy(why) if isinstance(error, TimeoutError) else NoSession(why)

    def _meet(self, connection: http.client.HTTPConnection) -> None:
        """Connect, and have the other end prove that it is the session; nothing secret is sent."""
        asked = secret.challenge()
        connection.request("GET", f"{WHO}?{asked}")
        answer = connection.getresponse()
        try:
            told = json.loads(answer.read(_MOST_ASKED_BYTES))
            proof, self._challenge, self._number = str(told["proof"]), str(told["challenge"]), 0
        except (ValueError, KeyError, TypeError):
            proof = ""
        if not secret.fits(proof, secret.answer(self._key, asked)):
            connection.close()
            raise Stranger(
                f"{self.folder}: another program answers at the port of its session, which has ended"
            )
        if connection.sock is None:
            raise NoSession(f"{self.folder}: its session does not keep the connection")
        self._was_seen = self._was_seen or _lives(self.pid)


def _spot(stated: Sequence[float | None]) -> Spot:
    return Spot._make(np.nan if one is None else one for one in stated)


def _lives(pid: int) -> bool:
    """Whether this system knows the process; False also where that cannot be asked."""
    if os.name != "posix":
        return False
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except OSError:
        return False
    return True


def running_sessions(output: Path) -> Iterator[Path]:
    """Folders in `output` whose session answers, the newest first, asked one after the other.

    One that was killed has left its file; whoever has its port meanwhile may take long to say nothing.
    """
    stated = []
    for path in output.glob(f"*/{CHANNEL_NAME}"):
        with contextlib.suppress(OSError):
            stated.append((path.stat().st_mtime, path.parent))
    for _, folder in sorted(stated, reverse=True):
        try:
            with Line(folder) as line:
                line.news()
        except (NoSession, OSError):
            continue
        yield folder
