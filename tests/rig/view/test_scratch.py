"""The record of a program that looks without measuring."""

from pathlib import Path

from acquisition.record.events import Event, EventKind
from acquisition.record.reader import RecordReader
from processing.deflections import DeflectionUnit
from processing.swing import HalfCycle
from rig.view import ScratchView

MOST_BYTES = 20_000
EPOCH_NS = 1_700_000_000_000_000_000
TEXTS = [f"event {number} " + 50 * "x" for number in range(400)]


def test_a_record_that_has_grown_too_large_is_replaced_and_the_view_goes_on(tmp_path: Path) -> None:
    unit = DeflectionUnit.PX
    with ScratchView("looking", "none", None, "balancing", unit, most_bytes=MOST_BYTES) as view:
        view.begin(0, epoch_offset_ns=EPOCH_NS)
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


def test_a_turning_point_before_the_first_frame_is_shown() -> None:
    """It is fitted, and the fit may place it there."""
    turn = HalfCycle(1, -3_000_000, 1e-6, 4e-4, 1e-8, 2.0, 1e-4, 0.0, 1, 0)
    with ScratchView("looking", "none", None, "balancing", DeflectionUnit.RAD) as view:
        view.begin(0, epoch_offset_ns=EPOCH_NS)
        view.half_cycles([turn])
        view.flush()
        with RecordReader(view._path) as record:
            assert [swing.turn_time_ns for swing in record.swings()] == [turn.turn_time_ns]
            assert record.utc(0).year == 2023
