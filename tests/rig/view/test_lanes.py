"""The lanes follow from the kinds of events, not from the lines of the log."""

from typing import Any, cast

import pytest
import rerun as rr

from acquisition.record.events import Event, EventKind
from rig.view import layout
from rig.view.drawing import RunLanes


class Stream:
    """Keeps which entity was drawn with what."""

    def __init__(self) -> None:
        self.drawn: list[tuple[str, object]] = []

    def log(self, entity: str, thing: object, **_: Any) -> None:
        self.drawn.append((entity, thing))


@pytest.mark.parametrize(
    ("kind", "lanes"),
    [
        (EventKind.START, {"run", "spot", "frames"}),
        (EventKind.LASER_DARK, {"laser"}),
        ("", set()),
        ("unknown", set()),
    ],
)
def test_a_lane_changes_with_the_kind_of_an_event(kind: str, lanes: set[str]) -> None:
    stream = Stream()
    RunLanes(cast(rr.RecordingStream, stream)).draw("run 1", kind)
    changed = {entity for entity, thing in stream.drawn if isinstance(thing, rr.StateChange)}
    assert changed == {layout.entity("run 1", lane) for lane in lanes}


def test_a_line_that_reads_like_an_event_changes_no_lane() -> None:
    stream = Stream()
    RunLanes(cast(rr.RecordingStream, stream)).draw("", Event(0, EventKind.STOP, "time limit").line)
    assert stream.drawn == []
