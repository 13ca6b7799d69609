"""What an operator notes is in the record of the run, with its time, and on the disk at once."""

import json
from pathlib import Path

import pytest

from acquisition.record.reader import RecordReader
from processing.errors import RigError
from rig.devices import OrderConnection, lit_devices
from rig.measure.session_orders import NOTES_NAME, Notes
from rig.report.source import read_source
from rig.view.show import show_record
from tests.rig.acting import acting, at_desk
from tests.rig.command_line import AT_ONCE, QUICK, run
from tests.rig.view.rrd_contents import column


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_note_goes_into_the_record_the_report_and_the_view_and_the_camera_sees_the_laser_off_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # on a busy machine frames come late
    monkeypatch.setattr(lit_devices, "_MAX_DARK_FRAMES_S", 30.0)
    out, said = tmp_path / "out", list[str]()

    def note(line: OrderConnection) -> None:
        """Two lines, once the record has begun."""
        if not said and (line.news()["state"].get("elapsed_s") or 0.0) > 1.0:
            said.append(line.order("note the lamp in the corridor\n is on"))
            said.append(line.order("note and off"))
            with pytest.raises(RigError, match="an empty note"):
                line.order("note  ")
        line.beat()

    live = {**QUICK, **AT_ONCE, "session.max_duration_s": "10", "session.operator": '"Ada"'}
    with acting(lambda: at_desk(out, note)):
        session = run(out, live, config="live.toml")
    assert said == ["noted: the lamp in the corridor is on", "noted: and off"], session.said
    assert "laser off, confirmed by the controller and the camera\n" in session.said
    with RecordReader(session.record) as record:
        notes, events, count = record.notes(), record.events(), record.counts["/note"]
    assert [(note.author, note.text) for note in notes] == [
        ("Ada", "the lamp in the corridor is on"),
        ("Ada", "and off"),
    ]
    assert all(events[0].time_ns < note.time_ns <= events[-1].time_ns for note in notes)
    assert count == 2
    assert "note" not in {event.kind for event in events}
    kept = [json.loads(line) for line in (out / NOTES_NAME).read_text("utf-8").splitlines()]
    assert [one["text"] for one in kept] == ["the lamp in the corridor is on", "and off"]
    lines = read_source(out / "results.json").runs[0].notes
    assert any(line.endswith("s, Ada: the lamp in the corridor is on") for line in lines)
    show_record(session.record, rrd=tmp_path / "run.rrd")
    texts = [text for (text,) in column(tmp_path / "run.rrd", "/events", "TextLog:text")[1]]
    assert "note: Ada: the lamp in the corridor is on" in texts


def test_a_note_that_cannot_be_kept_is_refused(tmp_path: Path) -> None:
    notes = Notes(tmp_path / "gone", "Ada")
    with pytest.raises(RigError, match="cannot be kept"):
        notes.write("lost")
    assert notes.take() == []
    with pytest.raises(RigError, match="at most 2000"):
        Notes(tmp_path, "Ada").write("x" * 2001)
