"""A session that is busy, or stopped, is still there; one that was killed is not."""

import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RigError
from processing.spot import Spot
from rig.desk.desk import Desk
from rig.desk.follower import RigFollower
from rig.desk.panels.live_picture import newest_frame
from rig.devices import ORDERS_NAME, OrderSocket, SessionNews, order_line
from rig.instrument import Block, configuration_attachments
from rig.measure.session_file import SessionFile
from rig.settings import Configuration, stored_configuration
from tests.rig.desk.conftest import simulated_rig
from tests.waiting import until


@pytest.fixture
def follower(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RigFollower]:
    """One that follows a session in `session` which answers, and has held the rig."""
    monkeypatch.setattr(order_line, "_MAX_ANSWER_S", 0.2)
    folder = tmp_path / "session"
    folder.mkdir()
    told = SessionNews()
    follower = RigFollower(tmp_path, lambda: folder)
    with OrderSocket(folder, told, {}):
        follower.start()
        until(lambda: follower.folder == folder)
    until(lambda: not follower.running)
    yield follower
    follower.stop()


def test_a_session_that_does_not_answer_is_not_given_up(follower: RigFollower, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    told = SessionNews()
    busy, asked = threading.Event(), 0

    def extra() -> dict[str, object]:
        nonlocal asked
        asked += 1
        if busy.is_set():
            time.sleep(0.5)
        return {}

    with OrderSocket(folder, told, {"stop": lambda _: "stopping"}, extra):
        follower.search_now()
        until(lambda: follower.running)
        busy.set()
        before = asked
        # it is asked again, and again, for longer than the second after which one that is gone is forgotten
        until(lambda: asked > before + 8)
        assert follower.folder == folder
        assert time.monotonic() - follower.news_s > 1.0
        assert follower.order("stop") == "stopping"
        busy.clear()
        until(lambda: time.monotonic() - follower.news_s < 1.0)
    until(lambda: not follower.running)


def test_a_session_is_known_at_once_and_its_events_as_they_are_recorded(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    told = SessionNews()
    follower = RigFollower(tmp_path)
    record = folder / "run-1.mcap"
    with OrderSocket(folder, told, {}), RecordWriter(record, time.time_ns()) as writer:
        told.begin_run("run 1", 255, None, record)
        nothing = np.zeros(1)
        at = Deflections(np.zeros(1, np.int64), *[nothing] * 4, DeflectionUnit.RAD)
        writer.write_spots([0], [0], [0], [Spot(*[0.0] * 10, 0)], at)
        writer.write_event(0, "camera lost", "unplugged")
        writer.flush()
        follower.start()
        # known at once: the desk's first page is built then, and shows the panel of a session
        assert follower.folder == folder
        assert follower.news
        until(lambda: bool(follower.events))
        assert [event["kind"] for event in follower.events] == ["camera lost"]
        told.begin_run("run 2", 255, None)
        until(lambda: follower.news["run"] == "run 2")
    follower.stop()


def test_a_desk_that_is_opened_while_the_last_session_is_fitted_knows_that(tmp_path: Path) -> None:
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        file = SessionFile.create(tmp_path / name, tmp_path / "rig.toml", 1, {})
        if name == "first":
            file.close()
    follower = RigFollower(tmp_path)
    follower.start()
    assert (follower.folder, follower.last_folder) == (None, tmp_path / "second")
    assert follower.is_fitting_last
    file.close()
    until(lambda: not follower.is_fitting_last)
    # who goes on with it is kept waiting by nobody
    SessionFile.opened(tmp_path / "second").close()
    follower.stop()


def test_a_session_that_was_killed_is_given_up_although_its_file_is_there(
    follower: RigFollower, tmp_path: Path
) -> None:
    folder = tmp_path / "session"
    told = SessionNews()
    with socket.create_server(("127.0.0.1", 0)) as gone:
        port = gone.getsockname()[1]
    with OrderSocket(folder, told, {}):
        follower.search_now()
        until(lambda: follower.running)
    (folder / ORDERS_NAME).write_text(json.dumps({"port": port, "key": "key", "pid": 1}))
    until(lambda: not follower.running)
    with pytest.raises(RigError, match="no session runs"):
        follower.order("stop")


def test_a_press_of_light_off_that_comes_by_two_ways_darkens_once(tmp_path: Path) -> None:
    """The later one may come when somebody has acknowledged already."""
    folder = tmp_path / "runs" / "session"
    folder.mkdir(parents=True)
    told = SessionNews()
    dark: list[str] = []
    desk = Desk(simulated_rig(tmp_path))
    with OrderSocket(folder, told, {"dark": lambda by: dark.append(by) or "dark"}):  # type: ignore[func-returns-value]
        desk.follower.start()
        for press in ("one", "one", "two"):
            assert desk.lighting.off(press) == ["no laser is switched by this program: turn its key"]
        until(lambda: len(dark) == 2)
        desk.lighting.off("one")
        desk.lighting.off("three")
        until(lambda: len(dark) == 3)
        assert dark == ["the desk"] * 3
    desk.close()


def test_the_look_at_a_running_session_has_the_lamp_of_its_reference(tmp_path: Path) -> None:
    source = simulated_rig(tmp_path)
    folder = tmp_path / "runs" / "session"
    folder.mkdir(parents=True)
    config = Configuration(camera={"driver": "simulated"}, reference={"from_row_px": 40})  # type: ignore[arg-type]
    SessionFile.create(folder, source, 1, stored_configuration(config)).close()
    told = SessionNews()
    told.begin_run("run 1", 255, None)
    desk = Desk(source)
    image = np.full((64, 32), 40, np.uint8)
    image[50, 3] = image[20, 4] = 255
    nothing = np.zeros(0)
    none = Deflections(np.zeros(0, np.int64), *[nothing] * 4, DeflectionUnit.PX)
    spot = Spot(16.0, 20.0, 0.01, 0.01, 2.0, 2.0, 0.0, 100.0, 4.0, 1.0, 0)
    with OrderSocket(folder, told, {}):
        desk.follower.start()
        until(lambda: "camera" in desk.follower.news)
        desk.follower.ask_picture()
        # as before a record: the run's phases show their frames the same way
        told.look([Frame(image, 1, 1, 1)], Block([spot], none, [], [], [spot._replace(y_px=50.0)]))

        def looked() -> bool:
            desk.follower.ask_picture()
            return newest_frame(desk) is not None

        until(looked)
        look = newest_frame(desk)
    desk.close()
    assert look is not None
    assert look.reference is not None
    assert look.reference.lamp.reason == "1 px are saturated"
    # what is the reference's is not counted as the pendulum's
    assert look.figures.saturated_px == 1
    assert "reference" in [lamp.name for lamp in look.lamps()]


def test_the_configuration_is_the_sessions_until_its_record_has_one(tmp_path: Path) -> None:
    folder, record = tmp_path / "session", tmp_path / "session" / "run-1.mcap"
    folder.mkdir()
    by_hand = Configuration(camera={"driver": "simulated"}, start={"way": "by hand"})  # type: ignore[arg-type]
    at_once = Configuration(camera={"driver": "simulated"}, start={"way": "at once"})  # type: ignore[arg-type]
    told, follower = SessionNews(), RigFollower(tmp_path)
    assert (follower.config, follower.unit) == (None, "")
    SessionFile.create(folder, tmp_path / "rig.toml", 1, stored_configuration(by_hand)).close()
    with OrderSocket(folder, told, {}):
        told.begin_run("run 1", 255, None, record)
        follower.start()
        assert follower.config == by_hand
        assert follower.unit == "px"
        kept = configuration_attachments(at_once, tmp_path / "rig.toml")
        with RecordWriter(record, time.time_ns(), attachments=kept):
            until(lambda: follower.config == at_once)
    follower.stop()
