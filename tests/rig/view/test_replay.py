"""Replay: independent of blocks, and the report of differences."""

import math
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycle
from rig.analysis import RunResults
from rig.analysis.result_rows import ResultRow
from rig.instrument.provenance import recorded_configuration
from rig.view.record_replay import replay_record
from rig.view.replay import Replay
from rig.view.replay_comparison import ReplayComparison, parameter_changes
from tests.rig.view.replay_record import GAP_FRAME, LOST_FRAME, RATE_HZ, WITHOUT_FIT, make_record


def test_a_replay_gives_the_record_bit_for_bit(tmp_path: Path) -> None:
    record = make_record(tmp_path / "run-1.mcap", 60.0, overrides=WITHOUT_FIT)
    # it was recorded in blocks of 25 frames, and is replayed in those of the reader
    with RecordReader(record) as reader:
        replay = Replay(reader, recorded_configuration(reader), retrack=False)
        sizes = [len(sequences) for sequences, _ in replay.blocks()]
        result = replay.finish()
    assert sum(sizes) == result.comparison.frames == 60 * RATE_HZ - 1
    assert max(sizes) > 25
    assert result.comparison.identical
    assert result.comparison.half_cycles.recorded == result.comparison.half_cycles.replayed >= 25
    assert result.dropped_frames == 1


def test_a_record_without_a_calibration_is_replayed_in_px_and_angles_are_not_compared_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A record replayed with the lever that it lacked had half-cycles changed by 1.5 × 10⁵ u."""
    path = make_record(tmp_path / "px.mcap", 20.0, calibrated=False)
    # that nothing can be fitted is no failure of the replay
    assert replay_record(path, None, retrack=False, overrides=[]) == 0
    said = capsys.readouterr().out
    assert "equal bit for bit" in said
    assert "contact laws not fitted: the record has no calibration" in said
    assert re.search(r"run 1: \d+ half-cycles, \d+\.\d\d to \d+\.\d\d px, 999 frames, 1 dropped", said)
    keys = ["lever.arm_m=1.0", "lever.pixel_pitch_m=4.8e-6", *WITHOUT_FIT]
    replay_record(path, None, retrack=False, overrides=keys)
    said = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("half-cycles"))
    assert "10 " in said
    assert float(re.findall(r"(\S+) u,|$", said)[0] or 0) < 0.1


def test_an_unknown_uncertainty_hides_no_other_change() -> None:
    """NaN for the first of two changes made the comparison say "only in uncertainties or flags"."""
    old = HalfCycle(1, 2_000_000_000, 1e-5, 100.0, math.nan, 2.0, 1e-5, 0.0, 1, 0)
    new = replace(old, turn_time_ns=old.turn_time_ns + 30_000)
    comparison = ReplayComparison(0, is_one_unit=True)
    found = comparison.finish([old], [new]).half_cycles
    assert found.largest_u == pytest.approx(3.0)
    rows = np.array(
        [(7, 10.0, math.nan, 20.0, 0.5)],
        dtype=[("sequence", int), *((name, float) for name in ("x_px", "u_x_px", "y_px", "u_y_px"))],
    )
    comparison.spots(rows, [Spot(10.0, 21.0, *[1.0] * 8, 0)])
    spots = comparison.finish([], []).spots
    assert (spots.largest_u, spots.largest_at) == (2.0, 7.0)


def test_windows_that_have_no_spot_do_not_hold_up_the_others(tmp_path: Path) -> None:
    path = make_record(tmp_path / "run.mcap", 20.0, windows=True)
    flags: dict[int, int] = {}
    with RecordReader(path) as reader:
        for sequences, block in Replay(reader, recorded_configuration(reader), retrack=True).blocks():
            flags.update(zip(sequences.tolist(), [spot.flags for spot in block.spots], strict=True))
    tracked = [number for number, flag in flags.items() if not flag & SpotFlag.LOST]
    assert GAP_FRAME not in flags
    assert tracked == [number for number in range(0, 1000, 10) if number not in (GAP_FRAME, LOST_FRAME)]


def test_a_changed_setting_is_compared_with_what_was_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = make_record(tmp_path / "run.mcap", 100.0)
    # a lever 1 % longer: angles 1 % smaller, every half-cycle and every law changes
    with RecordReader(record) as reader:
        lever = recorded_configuration(reader).lever
    assert lever is not None
    replay_record(record, None, retrack=False, overrides=[f"lever.arm_m={1.01 * lever.arm_m}"])
    said = capsys.readouterr().out
    half_cycles = next(line for line in said.splitlines() if line.startswith("half-cycles"))
    assert len(set(half_cycles.split()[1:4])) == 1
    assert " u, " in half_cycles
    assert "change / u" in said
    assert re.search(r"^γ / MPa +exact ", said, re.MULTILINE)


def test_changes_are_counted_in_recorded_uncertainties_and_by_their_fit() -> None:
    """A quantity of several parts, or of instrument and any decay, was compared by its last row alone."""

    def run(value: float, start: float) -> RunResults:
        rows = (("instrument", value), ("instrument, start", start), ("decay", 4.0))
        row = partial(ResultRow, quantity="log_decrement", u=0.5)
        unknown = ResultRow(quantity="friction_exponent", value=1.0)
        return RunResults(
            record="run-1.mcap", table=(*(row(fit=fit, value=one) for fit, one in rows), unknown)
        )

    changes = parameter_changes(run(2.0, 1.0), run(3.0, 1.5))
    assert [(change.quantity, change.fit, change.change_u) for change in changes] == [
        ("log_decrement", "instrument", 2.0),
        ("log_decrement", "instrument, start", 1.0),
        ("log_decrement", "decay", 0.0),
    ]


def test_a_cut_record_is_replayed_and_the_remedy_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    data = make_record(tmp_path / "run-1.mcap", 30.0, overrides=WITHOUT_FIT).read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    assert replay_record(cut, None, retrack=False, overrides=[]) in (0, 1)
    said = capsys.readouterr()
    (line,) = (line for line in said.err.splitlines() if "cut short" in line)
    assert f"rig record recover {cut}" in line
