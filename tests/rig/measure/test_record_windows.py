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
    """The same seconds recorded with windows and without them."""
    counts, sizes = [], []
    for kept in ("true", "false"):
        config = configured({**SMALL, "session.max_duration_s": "6", "record.windows": kept})
        record = tmp_path / f"{kept}.mcap"
        assert record_plainly(config, CONFIGS / "demo.toml", record) == 0
        sizes.append(pixels_path(record).stat().st_size)
        with RecordReader(record) as reader:
            counts.append({topic: count for topic, count in reader.counts.items() if count})
    assert counts[0][WINDOW.topic] > 250
    assert counts[0].keys() - {WINDOW.topic} == counts[1].keys()
    assert sizes[1] < 0.5 * sizes[0]
    replay_record(record, None, retrack=False, overrides=[])
    assert "equal bit for bit" in capsys.readouterr().out
    with pytest.raises(RecordError, match=r"record\.windows = false.*without --retrack") as refused:
        replay_record(record, None, retrack=True, overrides=[])
    assert len(str(refused.value).splitlines()) == 1
