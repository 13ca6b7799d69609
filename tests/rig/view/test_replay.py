"""Replay: independent of blocks, and report of differences."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError, RecordError
from processing.estimate import Estimate
from processing.spot import SpotFlag
from rig.analysis import Fit, InstrumentResults, RunResults, analyse_record
from rig.analysis.result_rows import ResultRow
from rig.instrument.provenance import recorded_configuration
from rig.view import record_replay
from rig.view.record_replay import replay_record
from rig.view.replay import Replay
from rig.view.replay_comparison import parameter_changes
from tests.rig.view.replay_record import GAP_FRAME, LOST_FRAME, RATE_HZ, make_record

SECONDS = 100.0
FRAMES = round(SECONDS * RATE_HZ) - 1


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_record(tmp_path_factory.mktemp("replay") / "run-1.mcap", SECONDS)


@contextmanager
def replay_of(record: Path, **words: float | bool) -> Iterator[Replay]:
    with RecordReader(record) as reader:
        settings = {"retrack": False, **words}
        yield Replay(reader, recorded_configuration(reader), **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("most", [1, 7, 89, 10_000])
def test_blocks_of_any_size_give_the_record_bit_for_bit(record: Path, most: int) -> None:
    with replay_of(record) as replay:
        frames = sum(len(step.sequences) for step in replay.steps(most))
        result = replay.finish()
    assert result.comparison.identical
    assert result.comparison.spots == frames == FRAMES
    assert result.comparison.swings_recorded == result.comparison.swings_replayed >= 25
    assert result.dropped_frames == 1


def test_a_part_begins_and_ends_where_it_is_told(record: Path) -> None:
    with replay_of(record, from_s=10.0, to_s=40.0) as replay:
        assert len(list(replay.steps(1000))) > 1
        result = replay.finish()
    assert replay.partial
    assert sum(map(len, result.deflections)) == 30 * RATE_HZ + 1 - 1
    assert result.dropped_frames == 1
    comparison = result.comparison
    assert (comparison.spots, comparison.spots_changed) == (30 * RATE_HZ, 0)
    # the same turning points, found by a pipeline that began later: within some of their uncertainties
    assert comparison.swings_replayed == comparison.swings_recorded >= 12
    assert comparison.largest_swing_change_u < 8.0


def test_what_is_analysed_is_what_the_record_says_itself(
    record: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert replay_record(record, None, retrack=False, overrides=[]) == 0
    said = capsys.readouterr().out
    run = analyse_record(record).results
    assert (run.frames, run.dropped_frames) == (FRAMES, 1)
    assert f"{FRAMES} frames, 1 dropped" in said
    assert "equal bit for bit" in said


def test_a_record_without_a_calibration_is_replayed_in_px(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = make_record(tmp_path / "px.mcap", 20.0, calibrated=False)
    # that nothing can be fitted is no failure of the replay
    assert replay_record(path, None, retrack=False, overrides=[]) == 0
    said = capsys.readouterr().out
    assert "equal bit for bit" in said
    assert "contact laws not fitted: the record has no calibration" in said
    assert re.search(r"run 1: \d+ half-cycles, \d+\.\d\d to \d+\.\d\d px, 999 frames, 1 dropped", said)


def test_without_a_terminal_a_line_says_now_and_then_how_far_it_is(
    record: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(record_replay, "_PLAIN_INTERVAL_S", 0.0)
    monkeypatch.setattr(record_replay, "_MOST_FRAMES", {False: 2000, True: 64})
    replay_record(record, None, retrack=False, overrides=[])
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("replaying")]
    last = r"replaying  \d+\.\d\d of 100\.0 s  \d+ %  \d+ frames  \d+ half-cycles  \d+\.\d\d arcsec"
    assert len(lines) > 2
    assert re.fullmatch(f"{last}  about 0:0\\d left", lines[-1])


def test_windows_that_have_no_spot_do_not_hold_up_the_others(tmp_path: Path) -> None:
    path = make_record(tmp_path / "run.mcap", 20.0, windows=True)
    with replay_of(path, retrack=True) as replay:
        flags: dict[int, int] = {}
        for step in replay.steps(100):
            found = [spot.flags for spot in step.block.spots]
            flags.update(zip(step.sequences.tolist(), found, strict=True))
    tracked = [number for number, flag in flags.items() if not flag & SpotFlag.LOST]
    assert GAP_FRAME not in flags
    assert tracked == [number for number in range(0, 1000, 10) if number not in (GAP_FRAME, LOST_FRAME)]


def test_a_changed_setting_is_compared_with_what_was_recorded(
    record: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # a lever 1 % longer: angles 1 % smaller, every half-cycle and every law changes
    with RecordReader(record) as reader:
        lever = recorded_configuration(reader).lever
    assert lever is not None
    words = [f"lever.arm_m={1.01 * lever.arm_m}"]
    replay_record(record, None, retrack=False, overrides=words)
    said = capsys.readouterr().out
    half_cycles = next(line.split() for line in said.splitlines() if line.startswith("half-cycles"))
    assert half_cycles[1] == half_cycles[2] == half_cycles[3]
    assert " u, " in next(line for line in said.splitlines() if line.startswith("half-cycles"))
    assert "change / u" in said
    assert any(line.startswith("b / rad⁻ᵖ") for line in said.splitlines())


def test_changes_of_parameters_are_counted_in_recorded_uncertainties() -> None:
    def run(value: float) -> RunResults:
        estimate = Estimate(value, 0.5)
        moment = ResultRow(quantity="friction_moment", value=value, u_total=0.5)
        return RunResults(
            record="run-1.mcap",
            fits={"exact": Fit(parameters={"b": estimate, "start_time_s": estimate}, chi2_per_dof=1.0)},
            table=(moment, ResultRow(quantity="friction_exponent", value=1.0)),
            instrument=InstrumentResults(kind="herbert"),
        )

    changes = parameter_changes(run(2.0), run(3.0))
    assert [(change.name, change.in_u) for change in changes] == [
        ("fits.exact.b", 2.0),
        ("friction_moment", 2.0),
    ]


def test_a_cut_record_is_replayed_and_the_remedy_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    data = make_record(tmp_path / "run-1.mcap", 30.0).read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    assert replay_record(cut, None, retrack=False, overrides=[]) in (0, 1)
    said = capsys.readouterr()
    (line,) = (line for line in said.err.splitlines() if "cut short" in line)
    assert f"rig record recover {cut}" in line


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        ({"from_s": -1.0}, ConfigurationError, "must begin before it ends"),
        ({"from_s": 5.0, "to_s": 5.0}, ConfigurationError, "must begin before it ends"),
        ({"from_s": 500.0}, RecordError, r"is 100\.0 s long and cannot start at 500 s"),
    ],
)
def test_a_part_that_is_none(
    record: Path, words: dict[str, float], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        replay_record(record, None, retrack=False, overrides=[], **words)  # type: ignore[arg-type]
