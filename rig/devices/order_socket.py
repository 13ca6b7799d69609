"""The state of a session, and the order socket by which other programs ask for it and give orders.

The socket belongs to the process that has the devices: a loopback port that answers holders of its key.
"""

import json
import math
import os
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, answer_challenge, deliver_challenge
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from acquisition.camera import CameraSettings, Frame, Image
from processing.deflections import Deflections
from processing.errors import ConfigurationError, RigError
from processing.spot import Spot, SpotFlag
from processing.units import NS_PER_S
from rig.devices.session_devices import Devices
from rig.instrument import Block
from rig.terminal import Verdict, plain_values

PATH_S = 20.0
"""Length of the trajectory that a page draws, in s."""
_PATH_POINTS = 400
_MAX_ABSENCE_S = 60.0
"""Longest absence of a desk, which may come back, before a run that waits for an acknowledgement ends."""


class SessionPicture(NamedTuple):
    """A frame (ny, nx) in DN, the spot in it, and its number."""

    image: Image
    spot: Spot
    number: int
    camera: Mapping[str, Any]
    """Full scale and settings with which the frame was taken."""
    reference: Spot | None = None
    beam: Verdict | None = None
    """Verdict on the beam; None where it was not judged."""


class SessionNews:
    """The state of a session, which its threads write, and which those that answer requests read.

    It holds a reference to the newest frame that a program has requested.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.news_request_s = self.picture_request_s = -math.inf
        """Monotonic times of the last requests for news, and for a picture."""
        self._picture_requested = False
        self._picture_number = 0
        self._frame: SessionPicture | None = None
        self._begin("", "", {})

    def _begin(self, run: str, record: str, camera: Mapping[str, Any]) -> None:
        self._path: deque[Deflections] = deque()
        self._values: dict[str, Any] = {"run": run, "record": record, "camera": camera}
        self._values |= {"state": {}, "rows": (), "preflight": ()}
        self._frames_s = self._spot_s = math.nan

    def begin_run(
        self, title: str, full_scale_dn: int, applied: CameraSettings | None, record: Path | None = None
    ) -> None:
        """Begin the news of a run, with the camera's settings as read back, and the path of its `record`."""
        settings = {} if applied is None else applied.model_dump(exclude_none=True)
        camera = {"full_scale_dn": full_scale_dn, "applied": settings}
        with self._lock:
            self._begin(title, "" if record is None else str(record.absolute()), camera)

    def state(self, values: Mapping[str, Any], rows: Sequence[tuple[str, str]]) -> None:
        """Set the state of the run as displayed: values for programs, and rows of text."""
        self._values |= {"state": values, "rows": rows}

    @property
    def phase(self) -> str:
        """The phase of the run; empty before any."""
        return str(self._values["state"].get("phase") or "")

    def waits(self, progress: str) -> None:
        """Set the state between two runs: that of the last run, and what the next one waits for."""
        self._values["state"] = {**self._values["state"], "progress": progress}

    def preflight(self, verdicts: Sequence[Verdict]) -> None:
        """Set the preflight table."""
        self._values["preflight"] = plain_values(verdicts)

    # -- in the run's thread --------------------------------------------------

    def look(self, frames: Sequence[Frame], block: Block, *, recorded: bool = False) -> None:
        """Keep the newest frame if it is wanted, and the trajectory of frames that are not recorded."""
        spots, deflections, now_s = block.spots, block.deflections, time.monotonic()
        if recorded:
            self._path.clear()
        elif len(deflections):
            with self._lock:
                path, newest_ns = self._path, deflections.times_ns[-1]
                path.append(deflections)
                while newest_ns - path[0].times_ns[-1] > PATH_S * NS_PER_S:
                    path.popleft()
        if spots:
            self._frames_s = now_s
            # a spot that was never found counts as lost since the first frame
            if math.isnan(self._spot_s) or not spots[-1].flags & SpotFlag.LOST:
                self._spot_s = now_s
        if self._picture_requested and frames and spots:
            self._picture_requested = False
            self.show(frames[-1].image, spots[-1], block.references[-1] if block.references else None)

    def show(
        self, image: Image, spot: Spot, reference: Spot | None = None, beam: Verdict | None = None
    ) -> None:
        """Keep a frame, the spots in it and the verdict on its beam."""
        self._frames_s = time.monotonic()
        self._picture_number += 1
        # a camera's frames are read-only and never written to again; anything else is copied
        stored_image = image.copy() if image.flags.writeable else image
        self._frame = SessionPicture(
            stored_image, spot, self._picture_number, self._values["camera"], reference, beam
        )

    # -- for those that answer -----------------------------------------------

    def news(self) -> dict[str, Any]:
        """Everything as plain values.

        Positions and amplitudes are as shown: arcsec, or px without a lever. `frames_age_s` is the age of the
        last processed frame, `spot_lost_s` the time for which the spot has been lost; NaN before the first
        frame. Recorded values are read from `record`.
        """
        self.news_request_s = time.monotonic()
        with self._lock:
            path, values = list(self._path), dict(self._values)
        return {
            **values,
            "frames_age_s": time.monotonic() - self._frames_s,
            "spot_lost_s": max(self._frames_s - self._spot_s, 0.0),
            "path": thinned_path(path),
        }

    @property
    def is_watched(self) -> bool:
        """Whether a program has asked for the news within the last minute."""
        return time.monotonic() - self.news_request_s < _MAX_ABSENCE_S

    def picture(self, last_number: int = 0) -> SessionPicture | None:
        """The newest frame, None if its number is not above `last_number`; this also requests the next."""
        self._picture_requested, self.picture_request_s = True, time.monotonic()
        frame = self._frame
        return None if frame is None or frame.number <= last_number else frame


def thinned_path(path: Sequence[Deflections]) -> dict[str, list[float | None]]:
    """The last seconds of the trajectory, in some hundred points, as they are shown."""
    if not path:
        return {"x": [], "y": []}
    step = max(1, math.ceil(sum(map(len, path)) / _PATH_POINTS))
    # there may be thousands of single deflections, so they are joined before they are divided by their unit
    size = path[0].unit.shown_size
    shown: dict[str, list[float | None]] = {}
    for name in ("x", "y"):
        values = np.concatenate([getattr(piece, name) for piece in path])[::step] / size
        shown[name] = [round(value, 4) if math.isfinite(value) else None for value in values.tolist()]
    return shown


ORDERS_NAME = ".orders.json"
LOOPBACK = "127.0.0.1"
BEAT = "beat"
"""Request that is answered at once with None."""
NEWS, LOOK = "news", "look"
_POLL_TIMEOUT_S = 0.2
_MAX_NOTICE_S, _POLL_INTERVAL_S = 1.0, 0.02
"""Longest time for which a client may learn at the end that the laser is off, and interval of the checks."""
_MAX_CONNECT_S = 1.0
Orders = Mapping[str, Callable[[str], str]]
"""Functions by the first word of an order; called with the rest, they return what was done, or raise
RigError.
"""


class OrderSocket:
    """A context manager: while it is open, the file in the session's folder names port and key.

    Each connection has a thread of its own, so that a client that stops in the middle blocks no other; both
    sides first prove that they know the key. `extra_news` is called for each answer, for values that only the
    devices have. Raises ConfigurationError where another program takes orders in this folder: they would
    reach only one of the two.
    """

    def __init__(
        self,
        folder: Path,
        session_news: SessionNews,
        orders: Orders,
        extra_news: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        self._path = folder / ORDERS_NAME
        self._answers: dict[str, Callable[[Any], Any]] = {
            **orders,
            BEAT: lambda _: None,
            NEWS: lambda _: plain_values({**session_news.news(), **extra_news()}),
            LOOK: session_news.picture,
        }
        self._key = secrets.token_bytes(24)
        self._ended = threading.Event()
        self._socket: socket.socket | None = None
        self.problem = ""
        """The reason why no socket could be opened, so that the session measures unwatched; else empty."""

    def __enter__(self) -> Self:
        try:
            self._socket = socket.create_server((LOOPBACK, 0), backlog=64)
            self._socket.settimeout(_POLL_TIMEOUT_S)
            port = self._socket.getsockname()[1]
            _write(self._path, {"port": port, "key": self._key.hex(), "pid": os.getpid()})
        except ConfigurationError:
            self._close()
            raise
        except OSError as error:
            self.problem = f"nobody can watch this session: {error}"
            self._close()
            return self
        threading.Thread(target=self._accept, args=(self._socket,), name="orders", daemon=True).start()
        return self

    def __exit__(self, *_error: object) -> None:
        # connected clients would otherwise be answered as long as the process lives, which may fit the data
        self._ended.set()
        if self._socket is not None:
            with suppress(OSError):
                self._path.unlink()
        self._close()

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _accept(self, listening: socket.socket) -> None:
        while not self._ended.is_set():
            try:
                client, _ = listening.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            client.settimeout(None)
            connection = Connection(client.detach())
            threading.Thread(target=self._serve, args=(connection,), name="order", daemon=True).start()

    def _serve(self, connection: Connection) -> None:
        # a client that has gone is no event
        with connection, suppress(OSError, EOFError, AssertionError, AuthenticationError):
            answer_challenge(connection, self._key)
            deliver_challenge(connection, self._key)
            while not self._ended.is_set():
                if connection.poll(_POLL_TIMEOUT_S):
                    request = connection.recv()
                    if self._ended.is_set():
                        return
                    connection.send(self._answer(*request))

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


def light_orders(devices: Devices) -> Orders:
    """Orders of a program that has the devices; `acknowledge` takes the trip's number and the person."""

    def acknowledge(value: str) -> str:
        number, _, place = value.partition(" ")
        if not number.isdecimal():
            raise RigError(f"acknowledge {value!r}: the number of the trip is needed")
        return devices.acknowledge(int(number), place or "the desk")

    return {"acknowledge": acknowledge, "dark": lambda place: devices.light_off(place or "the desk")}


@contextmanager
def light_shown_to_desk(
    devices: Devices, folder: Path, session_news: SessionNews | None = None, more_orders: Orders | None = None
) -> Iterator[None]:
    """Context in which a command that is no session lets the desk show its light, and switch it off.

    It takes the orders of `light_orders` and `more_orders`. `folder` is the one that the devices were opened
    with: the rig's lock names it, and a desk knows that of its own commands. Without a laser no folder is
    made, and no socket opened, unless there are `session_news` (with pictures). A client that has asked a
    moment ago learns at the end that the laser is off.
    """
    if devices.laser_report() is not None:
        with suppress(OSError):
            # without the folder the command runs unwatched
            folder.mkdir(parents=True, exist_ok=True)
    elif session_news is None or not folder.is_dir():
        yield
        return
    orders = {**light_orders(devices), **(more_orders or {})}
    news = session_news or SessionNews()
    with OrderSocket(folder, news, orders, lambda: safety_values(devices)):
        try:
            yield
        finally:
            devices.darken("the devices are closed")
            _tell_dark(devices, news)


def _tell_dark(devices: Devices, news: SessionNews) -> None:
    """Answer the client that watches the light until it has learned that it is off, or for a second."""
    start_s, dark_s = time.monotonic(), math.inf
    first_s, deadline_s = start_s - _MAX_NOTICE_S, start_s + _MAX_NOTICE_S
    while first_s < news.news_request_s < dark_s and time.monotonic() < deadline_s:
        if devices.confirmed_dark:
            dark_s = min(dark_s, time.monotonic())
        time.sleep(_POLL_INTERVAL_S)


def _write(path: Path, values: Mapping[str, object]) -> None:
    """Write the file at once, for this user only, over one that a killed program has left; if its program
    lives, ConfigurationError."""
    draft = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        json.dump(values, file)
    try:
        # of two that begin at once only one makes the link
        os.link(draft, path)
        draft.unlink()
    except OSError:
        if (process := _watched_process(path)) is not None:
            draft.unlink()
            raise ConfigurationError(
                f"{path.parent}: process {process} takes its orders there: end it, or name another folder"
            ) from None
        draft.replace(path)


def _watched_process(path: Path) -> int | None:
    """The process that takes orders by this file, also one that is frozen; None if it is gone."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        address = json.loads(path.read_text(encoding="ascii"))
        process = int(address["pid"])
        if lives(process):
            socket.create_connection((LOOPBACK, int(address["port"])), timeout=_MAX_CONNECT_S).close()
            return process
    return None


def lives(process: int) -> bool:
    """Whether a process exists; False also where the system cannot be asked."""
    if os.name != "posix":
        return False
    try:
        os.kill(process, 0)
    except PermissionError:
        return True
    except OSError:
        return False
    return True
