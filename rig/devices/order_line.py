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

_ANSWER_S = 3.0
_ORDER_S = 20.0


class NoSession(RigError):
    """No session runs in this folder, or it does not answer."""


class SessionBusy(NoSession):
    """A session is connected, or its connection is being made, but it does not answer in time."""


class OrderConnection:
    """Connection to the session that runs in a folder; any thread may use it, one at a time.

    Raises NoSession, as every method does, where no session answers; SessionBusy if it may do so later.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            stated = json.loads((folder / ORDERS_NAME).read_text(encoding="ascii"))
            self._key = bytes.fromhex(stated["key"])
            self._port, self.pid = int(stated["port"]), int(stated["pid"])
        except (OSError, ValueError, KeyError, TypeError):
            raise NoSession(f"{folder}: no session runs here") from None
        self._connection: Connection | None = None
        self._was_seen = False
        self._one_at_a_time = threading.Lock()

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
        """False once the process that answered first is gone, whose port another program may have now."""
        return not (self._was_seen and not lives(self.pid))

    @property
    def process(self) -> int | None:
        """Number of the process that has answered; None before."""
        return self.pid if self._was_seen else None

    def beat(self) -> None:
        """Return once the session has answered, which it does without any work or wait."""
        self._ask(BEAT)

    def news(self) -> dict[str, Any]:
        """The news of the session, from `SessionNews.news`."""
        found: dict[str, Any] = self._ask(NEWS)
        return found

    def picture(self, after: int = 0) -> SessionPicture | None:
        """The newest frame if its number is above `after`, else None; this also requests the next one."""
        found: SessionPicture | None = self._ask(LOOK, after)
        return found

    def order(self, name: str) -> str:
        """Carry out an order; returns what was done. Raises RigError with the reason if it was not."""
        # a frozen session must not find old orders when it continues, so it must answer first
        self.beat()
        first, _, rest = name.partition(" ")
        done, answer = self._answer(first, rest, _ORDER_S)
        if not done:
            raise RigError(str(answer))
        return str(answer)

    def _ask(self, name: str, value: object = None) -> Any:
        done, answer = self._answer(name, value, _ANSWER_S)
        if not done:
            raise NoSession(f"{self.folder}: its session cannot answer: {answer}")
        return answer

    def _answer(self, name: str, value: object, within_s: float) -> tuple[bool, Any]:
        with self._one_at_a_time:
            try:
                connection = self._connection = self._connection or self._connect()
                connection.send((name, value))
                if not connection.poll(within_s):
                    raise TimeoutError(f"nothing within {within_s:g} s")
                done, answer = connection.recv()
            except AuthenticationError:
                self.close()
                raise NoSession(
                    f"{self.folder}: another program answers at the port of its session, which has ended"
                ) from None
            except (OSError, EOFError, ValueError) as error:
                self.close()
                raise self._no_answer(error) from None
        self._was_seen = self._was_seen or lives(self.pid)
        return done, answer

    def _connect(self) -> Connection:
        """A connection both of whose ends have proved that they know the key; raises OSError and the like."""
        made = socket.create_connection((LOOPBACK, self._port), timeout=_ANSWER_S)
        made.settimeout(None)
        if os.name == "posix":
            # a session may be stopped in the middle of an answer
            # whole seconds, and microseconds
            timeval = struct.pack("ll", int(_ANSWER_S), int(1e6 * (_ANSWER_S % 1.0)))
            for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
                made.setsockopt(socket.SOL_SOCKET, option, timeval)
        connection = Connection(made.detach())
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

    def _no_answer(self, error: Exception) -> NoSession:
        why = f"{self.folder}: its session does not answer: {error or 'it has hung up'}"
        return SessionBusy(why) if isinstance(error, (TimeoutError, BlockingIOError)) else NoSession(why)


def running_sessions(output: Path) -> Iterator[Path]:
    """Folders in `output` whose session answers, the newest first, asked one after the other.

    A killed session has left its file, and another program that has its port now may take long not to answer.
    """
    stated = []
    for path in output.glob(f"*/{ORDERS_NAME}"):
        with contextlib.suppress(OSError):
            stated.append((path.stat().st_mtime, path.parent))
    for _, folder in sorted(stated, reverse=True):
        try:
            with OrderConnection(folder) as line:
                line.news()
        except (NoSession, OSError):
            continue
        yield folder
