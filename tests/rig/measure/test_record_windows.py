"""`record.windows`: raw pixels around the spot are recorded or not."""

from pathlib import Path

import pytest

from acquisition.record import pixels_beside
from acquisition.record.reader import RecordReader
from acquisition.record.topics import WINDOW
from processing.errors import RecordError
from rig.measure import simulate_record
from rig.settings import load_configuration
from rig.view import replay_record
from tests.rig.command_line import CONFIGS, SMALL


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Path]:
    """The same ten seconds recorded with windows and without them."""
    folder = tmp_path_factory.mktemp("windows")
    found = {}
    for kept in (True, False):
        overrides = {**SMALL, "session.max_duration_s": "10", "record.windows": str(kept).lower()}
        config = load_configuration(
            CONFIGS / "demo.toml", [f"{key}={value}" for key, value in overrides.items()]
        )
        found[kept] = folder / f"{kept}.mcap"
        assert simulate_record(config, CONFIGS / "demo.toml", found[kept]) == 0
    return found


def test_a_record_without_windows_holds_none_and_is_smaller(records: dict[bool, Path]) -> None:
    counts = {}
    for kept, path in records.items():
        with RecordReader(path) as reader:
            counts[kept] = reader.counts
    assert counts[True][WINDOW.topic] > 400
    assert not counts[False].get(WINDOW.topic)
    assert {topic for topic, count in counts[True].items() if count} - {WINDOW.topic} == {
        topic for topic, count in counts[False].items() if count
    }
    without, with_windows = (pixels_beside(records[kept]).stat().st_size for kept in (False, True))
    assert without < 0.5 * with_windows


def test_it_is_replayed_bit_for_bit(records: dict[bool, Path], capsys: pytest.CaptureFixture[str]) -> None:
    replay_record(records[False], None, retrack=False, overrides=[])
    assert "equal bit for bit" in capsys.readouterr().out


def test_tracking_it_again_is_refused_in_one_line(records: dict[bool, Path]) -> None:
    with pytest.raises(RecordError, match=r"record\.windows = false.*without --retrack") as refused:
        replay_record(records[False], None, retrack=True, overrides=[])
    assert len(str(refused.value).splitlines()) == 1
