"""`record.windows`: raw pixels around the spot are recorded or not."""

from pathlib import Path

import pytest

from acquisition.record import pixels_path
from acquisition.record.reader import RecordReader
from acquisition.record.topics import WINDOW
from processing.errors import RecordError
from rig.measure import record_plainly
from rig.view import replay_record
from tests.rig.command_line import CONFIGS, SMALL, configured


def test_a_record_without_windows_is_smaller_and_replayed_but_not_tracked_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same ten seconds recorded with windows and without them."""
    records, counts = {}, {}
    for kept in (True, False):
        overrides = {**SMALL, "session.max_duration_s": "10", "record.windows": str(kept).lower()}
        config = configured(overrides)
        records[kept] = tmp_path / f"{kept}.mcap"
        assert record_plainly(config, CONFIGS / "demo.toml", records[kept]) == 0
    for kept, path in records.items():
        with RecordReader(path) as reader:
            counts[kept] = reader.counts
    assert counts[True][WINDOW.topic] > 400
    assert not counts[False].get(WINDOW.topic)
    assert {topic for topic, count in counts[True].items() if count} - {WINDOW.topic} == {
        topic for topic, count in counts[False].items() if count
    }
    without, with_windows = (pixels_path(records[kept]).stat().st_size for kept in (False, True))
    assert without < 0.5 * with_windows
    replay_record(records[False], None, retrack=False, overrides=[])
    assert "equal bit for bit" in capsys.readouterr().out
    with pytest.raises(RecordError, match=r"record\.windows = false.*without --retrack") as refused:
        replay_record(records[False], None, retrack=True, overrides=[])
    assert len(str(refused.value).splitlines()) == 1
