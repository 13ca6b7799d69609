"""A session answers who has its key, keeps a frame when one is wanted, and takes the orders it knows."""

import http.server
import json
import os
import socket
import stat
import subprocess
import threading
from collections.abc import Iterator
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, deliver_challenge
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.camera import Frame
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import ConfigurationError, DeviceError, RigError
from processing.spot import Spot
from rig.control import Interlock
from rig.devices import (
    LOOPBACK,
    ORDERS_NAME,
    Devices,
    NoSession,
    OrderConnection,
    OrderSocket,
    SessionNews,
    running_sessions,
)
from rig.instrument import Block
from rig.measure.session_orders import Notes, orders
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS

SPOT = Spot(3.0, 2.0, 0.01, 0.01, 1.5, 1.4, 0.0, 100.0, 4.0, 1.0, 0)


def refuse(_: str) -> str:
    raise DeviceError("the brake: does not answer; see its cable")


@pytest.fixture
def told() -> SessionNews:
    session_news = SessionNews()
    session_news.begin_run("run 1", 255, None)
    return session_news


@pytest.fixture
def line(told: SessionNews, tmp_path: Path) -> Iterator[OrderConnection]:
    folder = tmp_path / "session"
    folder.mkdir()
    orders = {"stop": lambda _: "stopping", "brake": refuse, "acknowledge": lambda number: f"trip {number}"}
    with (
        OrderSocket(folder, told, orders, lambda: {"opened": Interlock.LASER}),
        OrderConnection(folder) as opened,
    ):
        yield opened


def block(number: int, count: int = 16) -> tuple[list[Frame], Block]:
    """Frames whose pixels are their number, and what was found in them."""
    times_ns = np.arange(count, dtype=np.int64) * 10_000_000 + number * 1_000_000_000
    zeros = np.zeros(count)
    at = Deflections(times_ns, zeros, zeros + number, zeros, zeros, DeflectionUnit.PX)
    frames = [
        Frame(np.full((6, 8), number, np.uint8), k, int(time_ns), int(time_ns))
        for k, time_ns in enumerate(times_ns)
    ]
    return frames, Block([SPOT] * count, at, [], [])


def test_news_are_plain_values(told: SessionNews, line: OrderConnection) -> None:
    told.state({"amplitude": float("nan"), "phase": "measuring"}, [("elapsed", "0:02")])
    news = line.news()
    assert news["run"] == "run 1"
    assert news["state"] == {"amplitude": None, "phase": "measuring"}
    assert news["opened"] == "laser"
    # what the last run has measured stays to be read while the next one waits
    told.waits("light is to be asked for")
    assert line.news()["state"] == {**news["state"], "progress": "light is to be asked for"}


def test_a_frame_is_kept_only_when_somebody_has_asked(told: SessionNews, line: OrderConnection) -> None:
    told.look(*block(1))
    assert line.picture() is None
    told.look(*block(2))
    told.look(*block(3))
    picture = line.picture()
    assert picture is not None
    assert picture.number == 1
    np.testing.assert_array_equal(picture.image, np.full((6, 8), 2, np.uint8))
    assert picture.spot == SPOT
    assert picture.reference is None
    assert line.picture(picture.number) is None


def test_what_is_seen_before_the_record_is_told_until_the_record_tells_it(
    told: SessionNews, line: OrderConnection
) -> None:
    frames, found = block(1)
    line.picture()
    below = SPOT._replace(y_px=5.0, x_px=float("nan"))
    told.look(frames, found._replace(references=[SPOT, below]))
    # one that can be written to is copied
    frames[-1].image[:] = 99
    picture = line.picture()
    assert picture is not None
    assert picture.image.max() == 1
    assert picture.reference is not None
    assert picture.reference.y_px == 5.0
    assert np.isnan(picture.reference.x_px)
    assert line.news()["path"]["y"] == [1.0] * 16
    told.look(frames, found, recorded=True)
    assert line.news()["path"]["y"] == []


def test_who_is_connected_is_not_answered_after_its_end(told: SessionNews, tmp_path: Path) -> None:
    taken: list[str] = []
    with OrderSocket(tmp_path, told, {"stop": lambda: str(taken.append("stop"))}):
        line = OrderConnection(tmp_path)
        assert line.news()["run"] == "run 1"
    with line:
        with pytest.raises(NoSession):
            line.order("stop")
        assert taken == []
        with pytest.raises(NoSession):
            line.news()


def test_orders(line: OrderConnection) -> None:
    assert line.order("stop") == "stopping"
    assert line.order("acknowledge 5") == "trip 5"
    with pytest.raises(RigError, match="does not answer; see its cable"):
        line.order("brake on")
    with pytest.raises(RigError, match="knows no such order"):
        line.order("fly")


def connected(line: OrderConnection) -> Connection:
    """A connection to the session's port without any proof."""
    stated = json.loads((line.folder / ORDERS_NAME).read_text())
    made = socket.create_connection((LOOPBACK, stated["port"]), timeout=5)
    made.settimeout(None)
    return Connection(made.detach())


@pytest.mark.parametrize("key", [b"", b"another"])
def test_without_the_key_nothing_is_told_and_nothing_done(line: OrderConnection, key: bytes) -> None:
    with connected(line) as connection, pytest.raises((AuthenticationError, EOFError, OSError)):
        deliver_challenge(connection, key)
    # an order without any proof is taken for a wrong one
    with connected(line) as connection:
        connection.send(("stop", ""))
        with pytest.raises((EOFError, OSError)):
            connection.recv()
    # who stops while proving it holds nobody up
    with connected(line):
        assert line.order("stop") == "stopping"


def test_the_key_is_this_users_own_and_goes_with_the_session(told: SessionNews, tmp_path: Path) -> None:
    path = tmp_path / ORDERS_NAME
    with OrderSocket(tmp_path, told, {}):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert not path.exists()
    with pytest.raises(NoSession, match="no session runs here"):
        OrderConnection(tmp_path)


class _Another(http.server.BaseHTTPRequestHandler):
    """Any program that has got the port of a session which was killed."""

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is logged."""


def test_of_a_killed_session_only_the_file_is_left_whoever_has_its_port(
    told: SessionNews, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.devices.order_line._MAX_ANSWER_S", 0.5)
    killed, runs = tmp_path / "killed", tmp_path / "runs"
    killed.mkdir()
    runs.mkdir()
    ended = subprocess.Popen(["true"])
    ended.wait()
    with OrderSocket(runs, told, {}), http.server.HTTPServer((LOOPBACK, 0), _Another) as another:
        threading.Thread(target=another.serve_forever, daemon=True).start()
        own = json.loads((runs / ORDERS_NAME).read_text())["port"]
        for port in (another.server_address[1], own, 1):
            stated = {"port": port, "key": "00ff", "pid": ended.pid}
            (killed / ORDERS_NAME).write_text(json.dumps(stated))
            assert list(running_sessions(tmp_path)) == [runs]
            if port > 1:
                with OrderConnection(killed) as line:
                    for ask in (line.beat, lambda line=line: line.order("dark")):  # type: ignore[misc]
                        with pytest.raises(NoSession, match="another program answers"):
                            ask()
                    assert line.process is None
        another.shutdown()
    assert list(running_sessions(tmp_path)) == []
    # one that nobody can watch is measured all the same
    with OrderSocket(tmp_path / "missing", told, {}) as watched:
        assert "nobody can watch" in watched.problem


def test_two_programs_do_not_take_orders_in_one_folder(told: SessionNews, tmp_path: Path) -> None:
    """The second would be given the first one's orders, and take away its file."""
    with OrderSocket(tmp_path, told, {"dark": lambda _: "dark"}):
        with pytest.raises(ConfigurationError, match=f"process {os.getpid()} takes its orders there"):
            OrderSocket(tmp_path, told, {}).__enter__()
        with OrderConnection(tmp_path) as line:
            assert line.order("dark") == "dark"
        assert [path.name for path in tmp_path.iterdir()] == [ORDERS_NAME]
    # the file of one that was killed is in nobody's way
    (tmp_path / ORDERS_NAME).write_text(json.dumps({"port": 1, "key": "00ff", "pid": os.getpid()}))
    with OrderSocket(tmp_path, told, {}), OrderConnection(tmp_path) as line:
        line.beat()


def test_a_brake_is_refused_while_a_decay_is_recorded(told: SessionNews, tmp_path: Path) -> None:
    with Devices(load_configuration(CONFIGS / "live.toml")) as devices:
        brake = orders(devices, Notes(tmp_path, ""), told)["brake"]
        assert brake("on") == "brake on"
        told.state({"phase": "measuring"}, [])
        assert brake("off") == "brake off"
        with pytest.raises(RigError, match="spoil the decay that is being recorded: stop the run first"):
            brake("on")
