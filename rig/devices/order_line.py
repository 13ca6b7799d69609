"""The client's end of the order socket, by which a desk watches a session and gives orders."""

import contextlib
import json
import os
import socket
import struct
import threading
from collections.abc import Iterator
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, answer_challenge, deliver_challenge
from pathlib import Path
from typing import Any, Self

from processing.errors import RigError
from rig.devices.order_socket import BEAT, LOOK, LOOPBACK, NEWS, ORDERS_NAME, SessionPicture, lives

_MAX_ANSWER_S = 3.0
_MAX_ORDER_S = 20.0


class NoSession(RigError):
    """No session runs in this folder, or it does not answer."""


class SessionBusy(NoSession):
    """A session runs, but does not answer in time."""


class OrderConnection:
    """Connection to the session that runs in a folder; any thread may use it, one at a time.

    Raises NoSession, as every method does, where no session answers; SessionBusy if it may do so later.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            address = json.loads((folder / ORDERS_NAME).read_text(encoding="ascii"))
            self._key = bytes.fromhex(address["key"])
            self._port, self.pid = int(address["port"]), int(address["pid"])
        except (OSError, ValueError, KeyError, TypeError):
            raise NoSession(f"{folder}: no session runs here") from None
        self._connection: Connection | None = None
        self._has_answered = False
        self._request_lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; the next request connects again."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    @property
    def process_lives(self) -> bool:
        """False once the process that has answered is gone; another program may have its port now."""
        return not (self._has_answered and not lives(self.pid))

    @property
    def process(self) -> int | None:
        """Number of the process that has answered; None before."""
        return self.pid if self._has_answered else None

    def beat(self) -> None:
        """Return once the session has answered, which it does without any work or wait."""
        self._ask(BEAT)

    def news(self) -> dict[str, Any]:
        """The news of the session, from `SessionNews.news`."""
        news: dict[str, Any] = self._ask(NEWS)
        return news

    def picture(self, last_number: int = 0) -> SessionPicture | None:
        """The newest frame, None if its number is not above `last_number`; this also requests the next."""
        picture: SessionPicture | None = self._ask(LOOK, last_number)
        return picture

    def order(self, name: str) -> str:
        """Carry out an order; returns what was done. Raises RigError with the reason if it was not."""
        # a frozen session must not find old orders when it continues, so it must answer first
        self.beat()
        word, _, rest = name.partition(" ")
        is_done, answer = self._request(word, rest, _MAX_ORDER_S)
        if not is_done:
            raise RigError(str(answer))
        return str(answer)

    def _ask(self, name: str, value: object = None) -> Any:
        is_done, answer = self._request(name, value, _MAX_ANSWER_S)
        if not is_done:
            raise NoSession(f"{self.folder}: its session cannot answer: {answer}")
        return answer

    def _request(self, name: str, value: object, timeout_s: float) -> tuple[bool, Any]:
        with self._request_lock:
            try:
                connection = self._connection = self._connection or self._connect()
                connection.send((name, value))
                if not connection.poll(timeout_s):
                    raise TimeoutError(f"nothing within {timeout_s:g} s")
                is_done, answer = connection.recv()
            except AuthenticationError:
                self.close()
                raise NoSession(
                    f"{self.folder}: another program answers at the port of its session, which has ended"
                ) from None
            except (OSError, EOFError, ValueError) as error:
                self.close()
                error_class = SessionBusy if isinstance(error, (TimeoutError, BlockingIOError)) else NoSession
                reason = error or "it has hung up"
                raise error_class(f"{self.folder}: its session does not answer: {reason}") from None
        self._has_answered = self._has_answered or lives(self.pid)
        return is_done, answer

    def _connect(self) -> Connection:
        """A connection both of whose ends have proved that they know the key; raises OSError and the like."""
        client = socket.create_connection((LOOPBACK, self._port), timeout=_MAX_ANSWER_S)
        client.settimeout(None)
        if os.name == "posix":
            # a session may be stopped in the middle of an answer; seconds and microseconds
            timeval = struct.pack("ll", int(_MAX_ANSWER_S), int(1e6 * (_MAX_ANSWER_S % 1.0)))
            for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
                client.setsockopt(socket.SOL_SOCKET, option, timeval)
        connection = Connection(client.detach())
        try:
            # the client challenges first, because another program at this port may wait for a request
            deliver_challenge(connection, self._key)
            answer_challenge(connection, self._key)
        except (TimeoutError, BlockingIOError):
            connection.close()
            if os.name == "posix" and not lives(self.pid):
                # another program, which waits for a request of its own, has the port
                raise AuthenticationError from None
            raise
        except (OSError, EOFError, AssertionError, AuthenticationError):
            connection.close()
            raise AuthenticationError from None
        return connection


def running_sessions(output: Path) -> Iterator[Path]:
    """Folders in `output` whose session answers, the newest first, asked one after the other.

    A killed session has left its file, and another program that has its port now may take long not to answer.
    """
    folders = []
    for path in output.glob(f"*/{ORDERS_NAME}"):
        with contextlib.suppress(OSError):
            folders.append((path.stat().st_mtime, path.parent))
    for _, folder in sorted(folders, reverse=True):
        try:
            with OrderConnection(folder) as line:
                line.news()
        except (NoSession, OSError):
            continue
        yield folder
