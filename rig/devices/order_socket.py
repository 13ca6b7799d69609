"""The order socket of the process that has the devices: a loopback port that answers holders of its key."""

import json
import os
import secrets
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, answer_challenge, deliver_challenge
from pathlib import Path
from typing import Any, Self

from rig.devices.session_devices import Devices
from rig.devices.session_news import SessionNews
from rig.terminal import plain_values

ORDERS_NAME = ".orders.json"
LOOPBACK = "127.0.0.1"
BEAT = "beat"
"""Request that is answered at once with None."""
NEWS, LOOK = "news", "look"
_LOOK_S = 0.2
Orders = Mapping[str, Callable[[str], str]]
"""Functions by the first word of an order; called with the rest, they return what was done, or raise
RigError.
"""


class OrderSocket:
    """A context manager: while it is open, the file in the session's folder names port and key.

    Each connection has a thread of its own, so that a client that stops in the middle blocks no other; both
    sides first prove that they know the key. `extra` is called for each answer, for values that only the
    devices have. If the socket cannot be opened, the session measures unwatched, for the reason in `problem`.
    """

    def __init__(
        self,
        folder: Path,
        session_news: SessionNews,
        orders: Orders,
        extra: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        self._path = folder / ORDERS_NAME
        self._answers: dict[str, Callable[[Any], Any]] = {
            **orders,
            BEAT: lambda _: None,
            NEWS: lambda _: plain_values({**session_news.news(), **extra()}),
            LOOK: session_news.picture,
        }
        self._key = secrets.token_bytes(24)
        self._over = threading.Event()
        self._socket: socket.socket | None = None
        self.problem = ""

    def __enter__(self) -> Self:
        try:
            self._socket = socket.create_server((LOOPBACK, 0), backlog=64)
            self._socket.settimeout(_LOOK_S)
            port = self._socket.getsockname()[1]
            _write(self._path, {"port": port, "key": self._key.hex(), "pid": os.getpid()})
        except OSError as error:
            self.problem = f"nobody can watch this session: {error}"
            self._close()
            return self
        threading.Thread(target=self._accept, args=(self._socket,), name="orders", daemon=True).start()
        return self

    def __exit__(self, *_error: object) -> None:
        # connected clients would otherwise be answered as long as the process lives, which may fit the data
        self._over.set()
        if self._socket is not None:
            with suppress(OSError):
                self._path.unlink()
        self._close()

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _accept(self, listening: socket.socket) -> None:
        while not self._over.is_set():
            try:
                accepted, _ = listening.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            accepted.settimeout(None)
            connection = Connection(accepted.detach())
            threading.Thread(target=self._serve, args=(connection,), name="order", daemon=True).start()

    def _serve(self, connection: Connection) -> None:
        # a client that has gone is no event
        with connection, suppress(OSError, EOFError, AssertionError, AuthenticationError):
            answer_challenge(connection, self._key)
            deliver_challenge(connection, self._key)
            while not self._over.is_set():
                if connection.poll(_LOOK_S):
                    asked = connection.recv()
                    if self._over.is_set():
                        return
                    connection.send(self._answer(*asked))

    def _answer(self, name: str, value: Any) -> tuple[bool, Any]:
        """Whether a request or an order was carried out, and its result or the reason why not."""
        try:
            if name in self._answers:
                return True, self._answers[name](value)
        except Exception as error:
            # any error is reported to the client, and must not end the session
            return False, str(error) or type(error).__name__
        return False, f"{name!r}: this session knows no such order"


def safety_values(devices: Devices) -> dict[str, Any]:
    """State of laser, controller and interlock as plain values; never blocks."""
    return {"darkness": devices.darkness(), "safety": asdict(devices.safety())}


@contextmanager
def light_told(devices: Devices, folder: Path, session_news: SessionNews | None = None) -> Iterator[None]:
    """Context in which a command that is no session lets the desk show its light, and darken it.

    `folder` is the one that the devices were opened with, which the rig's lock names. A simulated rig has no
    lock, and opens no socket, unless there are `session_news` (pictures of frames that are recorded) for
    clients that know the folder.
    """
    if devices.state.path is None and session_news is None:
        yield
        return
    with suppress(OSError):
        # without the folder the command runs unwatched
        folder.mkdir(parents=True, exist_ok=True)
    orders = {"dark": lambda _: devices.light_off("the desk")}
    with OrderSocket(folder, session_news or SessionNews(), orders, lambda: safety_values(devices)):
        yield


def _write(path: Path, values: Mapping[str, object]) -> None:
    """Replace the file as a whole, readable by this user only."""
    new = path.with_name(f"{path.name}.{os.getpid()}")
    with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        json.dump(values, file)
    new.replace(path)
