"""The other end of a session's loopback port, from which a desk watches and orders."""

import contextlib
import http.client
import json
import os
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from acquisition.frame import Image
from processing.errors import RigError
from processing.spot import Spot
from rig.channel.server import BEAT, CHANNEL_NAME, LOOPBACK, SERVER, SPECTRA

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


class Line:
    """Connected to the session that runs in a folder. May be used from any thread, by one at a time.

    Raises NoSession, as every method does, where no session answers; SessionBusy if it may do so later.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            stated = json.loads((folder / CHANNEL_NAME).read_text(encoding="ascii"))
            port, self._key, self.pid = int(stated["port"]), str(stated["key"]), int(stated["pid"])
        except (OSError, ValueError, KeyError, TypeError):
            raise NoSession(f"{folder}: no session runs here") from None
        self._connection = http.client.HTTPConnection(LOOPBACK, port, timeout=_ANSWER_S)
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
        self._ask("GET", BEAT)

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
        # one that is frozen must not find, when it goes on, what was asked of it long ago
        self.beat()
        _, _, data = self._ask("POST", "/order", name)
        answer = json.loads(data)
        if not answer["ok"]:
            raise RigError(str(answer["text"]))
        return str(answer["text"])

    def _ask(self, method: str, path: str, body: str | None = None) -> tuple[int, str, bytes]:
        with self._one_at_a_time:
            connection = self._connection
            connection.timeout = _ORDER_S if method == "POST" else _ANSWER_S
            if connection.sock is not None:
                connection.sock.settimeout(connection.timeout)
            data = None if body is None else body.encode()
            try:
                connection.request(method, path, data, {"Authorization": self._key})
                answer = connection.getresponse()
                told = answer.read()
            except (OSError, http.client.HTTPException) as error:
                connection.close()
                raise self._unanswered(error) from None
            if answer.getheader("Server", "").strip() != SERVER:
                connection.close()
                raise NoSession(
                    f"{self.folder}: another program answers at the port of its session, which has ended"
                )
        if answer.status not in (http.HTTPStatus.OK, http.HTTPStatus.NO_CONTENT):
            raise NoSession(f"{self.folder}: its session refused to answer ({answer.status})")
        self._was_seen = self._was_seen or _lives(self.pid)
        return answer.status, answer.getheader("About") or "", told

    def _unanswered(self, error: Exception) -> NoSession:
        why = f"{self.folder}: its session does not answer: {error}"
        return SessionBusy(why) if isinstance(error, TimeoutError) else NoSession(why)


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
