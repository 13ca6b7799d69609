"""The events of a session stand in one order, all since the record of the present run began."""

import math
import time
from typing import Any

import numpy as np

from acquisition.frame import Frame
from acquisition.record.events import Event, EventKind
from processing.deflections import Deflections, DeflectionUnit
from processing.ticks import nanoseconds
from rig.instrument import Block
from rig.orders import SessionNews, newest_first
from rig.settings import Configuration


def record(told: SessionNews, start_ns: int, length_s: float) -> None:
    """Frames from the beginning of a record on."""
    times_ns = np.array([start_ns, start_ns + nanoseconds(length_s)], dtype=np.int64)
    zeros = np.zeros(2)
    frames = [Frame(np.zeros((6, 8), np.uint8), k, int(t), int(t)) for k, t in enumerate(times_ns)]
    at = Deflections(times_ns, zeros, zeros, zeros, zeros, DeflectionUnit.PX)
    told.block(start_ns, frames, Block([], at, [], []))


def log(told: SessionNews) -> list[tuple[float, str]]:
    news: dict[str, Any] = told.news()
    return [(at_s, event["text"]) for at_s, event in newest_first(news, news["events"])]


def test_events_have_one_origin_and_the_newest_is_first() -> None:
    told = SessionNews(Configuration(camera={"driver": "simulated"}))  # type: ignore[arg-type]
    told.begin_run("run 1", 255, None)
    told.note("interlock", "waits for a person")
    assert [math.isnan(at_s) for at_s, _ in log(told)] == [True]
    start_ns = nanoseconds(50.0)
    # the record begins with frames that were kept, so that what came before may lie in it
    for at_s, text in ((2.6, "rest"), (-1.3, "magnet"), (0.0, "first frame"), (2.0, "go")):
        told.event(start_ns, Event(start_ns + nanoseconds(at_s), EventKind.START, text))
    record(told, start_ns, 3.0)
    found = log(told)
    of_record = [text for _, text in found if text != "waits for a person"]
    assert of_record == ["rest", "go", "first frame", "magnet"]
    times_s = [at_s for at_s, _ in found]
    assert times_s == sorted(times_s, reverse=True)
    # noted before the frame was there that is 3 s after the first
    (noted_s,) = [at_s for at_s, text in found if text == "waits for a person"]
    assert noted_s <= 3.0


def test_events_of_an_earlier_run_come_before_the_record_of_this_one() -> None:
    told = SessionNews(Configuration(camera={"driver": "simulated"}))  # type: ignore[arg-type]
    told.begin_run("run 1", 255, None)
    record(told, 0, 1.0)
    told.event(0, Event(nanoseconds(900.0), EventKind.STOP, "the first run's end"))
    time.sleep(0.02)
    told.begin_run("run 2", 255, None)
    record(told, 0, 0.0)
    told.event(0, Event(0, EventKind.START, "the second run's beginning"))
    assert [text for _, text in log(told)] == ["the second run's beginning", "the first run's end"]
    assert log(told)[1][0] < 0.0
