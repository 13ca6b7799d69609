"""How a run ended is the kind of its last event."""

import pytest

from acquisition.record.events import Event, EventKind, end_of

START = Event(0, EventKind.START, "first frame")


@pytest.mark.parametrize(
    ("recorded", "text", "kind"),
    [
        (EventKind.STOP, "time limit of 90 s reached", EventKind.STOP),
        (EventKind.STOP, "a start that was not accepted came before", EventKind.STOP),
        (EventKind.REJECTED, "start not accepted: first amplitude 8.0 arcsec", EventKind.REJECTED),
        (EventKind.REJECTED, "said in other words", EventKind.REJECTED),
    ],
)
def test_the_end_is_known_by_its_kind(recorded: EventKind, text: str, kind: EventKind) -> None:
    after = Event(10, EventKind.LASER, "off")
    assert end_of([START, Event(9, recorded, text), after]) == Event(9, kind, text)


def test_a_record_without_an_end_was_cut_short() -> None:
    assert end_of([START, Event(9, EventKind.GAP, "start not accepted: not by this")]) is None
