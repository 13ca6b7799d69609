"""The record of a program that looks without measuring."""

from pathlib import Path

from acquisition.record.events import Event, EventKind
from acquisition.record.reader import RecordReader
from processing.deflections import DeflectionUnit
from rig.view import ScratchHead, ScratchView

MOST_BYTES = 20_000
TEXTS = [f"event {number} " + 50 * "x" for number in range(400)]


def test_a_record_that_has_grown_too_large_is_replaced_and_the_view_goes_on(tmp_path: Path) -> None:
    head = ScratchHead({}, {}, DeflectionUnit.PX)
    with ScratchView("looking", "none", None, "balancing", most_bytes=MOST_BYTES) as view:
        view.begin(0, head)
        folder, replaced = view._path.parent, 0
        for number, text in enumerate(TEXTS):
            before = view._writer
            view.event(Event(number, EventKind.ADVICE, text))
            assert view._writer is not None
            replaced += view._writer is not before
            view._writer.flush()
        assert replaced > 1
        # one record is there, and it holds what came last
        assert [path.name for path in folder.glob("*")] == ["looking.mcap"]
        assert view._path.stat().st_size < 2 * MOST_BYTES
        with RecordReader(view._path) as record:
            assert [event.text for event in record.events()][-1] == TEXTS[-1]
    assert not folder.exists()
