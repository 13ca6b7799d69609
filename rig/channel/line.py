"""The other end of a session's channel: asks a running session, and gives it orders."""

import contextlib
import http.client
import json
import threading
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from acquisition.frame import Image
from processing.errors import RigError
from processing.spot import Spot
from rig.channel.server import CHANNEL_NAME, LOOPBACK

_ANSWER_S = 3.0
_ORDER_S = 20.0
_KINDS = {"uint8": np.uint8, "uint16": np.uint16}


class NoSession(RigError):
    """No session runs in this folder, or it does not answer."""


class SessionBusy(NoSession):
    """A session is connected, or its connection is being made, but it does not answer in time."""


class SessionPicture(NamedTuple):
    """A frame (ny, nx) in DN, and the spot in it."""

    image: Image
    spot: Spot
    number: int


class Line:
    """Connected to the session that runs in a folder. May be used from any thread, by one at a time.

    Raises NoSession, as every method does, where nobody answers; SessionBusy if somebody may do so later.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            stated = json.loads((folder / CHANNEL_NAME).read_text(encoding="ascii"))
            port, self._key, self.pid = int(stated["port"]), str(stated["key"]), int(stated["pid"])
        except (OSError, ValueError, KeyError, TypeError):
            raise NoSession(f"{folder}: no session runs here") from None
        self._connection = http.client.HTTPConnection(LOOPBACK, port, timeout=_ANSWER_S)
        self._one_at_a_time = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._connection.close()

    def news(self, after: int = 0) -> dict[str, Any]:
        """What `SessionTelling.news` says."""
        _, _, data = self._ask("GET", f"/news?after={after}")
        found: dict[str, Any] = json.loads(data)
        return found

    def picture(self, after: int = 0) -> SessionPicture | None:
        """The newest frame if it is newer than `after`; asks for the next one, too."""
        status, about, data = self._ask("GET", f"/picture?after={after}")
        if status == http.HTTPStatus.NO_CONTENT:
            return None
        told = json.loads(about)
        image = np.frombuffer(data, _KINDS[told["dtype"]]).reshape(told["shape"])
        spot = Spot._make(np.nan if one is None else one for one in told["spot"])
        return SessionPicture(image, spot, int(told["number"]))

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
                connection.request(method, path, body, {"Authorization": self._key})
                if connection.sock is not None:
                    connection.sock.settimeout(_ORDER_S if method == "POST" else _ANSWER_S)
                answer = connection.getresponse()
                data = answer.read()
            except (OSError, http.client.HTTPException) as error:
                connection.close()
                why = f"{self.folder}: its session does not answer: {error}"
                raise (SessionBusy if isinstance(error, TimeoutError) else NoSession)(why) from None
        if answer.status not in (http.HTTPStatus.OK, http.HTTPStatus.NO_CONTENT):
            raise NoSession(f"{self.folder}: its session refused to answer ({answer.status})")
        return answer.status, answer.getheader("About") or "", data


def running_sessions(output: Path) -> list[Path]:
    """Folders in `output` whose session answers, the newest first; one that was killed has left its file."""
    found = []
    with contextlib.suppress(OSError):
        for path in output.glob(f"*/{CHANNEL_NAME}"):
            try:
                with Line(path.parent) as line:
                    line.news()
                found.append((path.stat().st_mtime, path.parent))
            except (NoSession, OSError):
                continue
    return [folder for _, folder in sorted(found, reverse=True)]
