"""Replay: independent of speed and blocks, control by keys, and report of differences."""

import io
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError
from processing.estimate import Estimate
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycle
from rig.analysis import Fit, InstrumentResults, RunResults
from rig.analysis.result_rows import ResultRow
from rig.instrument.provenance import recorded_configuration
from rig.instrument.run_now import RunNow
from rig.terminal.quantities import KeyParser, Keys
from rig.view.record_replay import replay_record, speed_of
from rig.view.replay import Replay
from rig.view.replay_comparison import ReplayComparison, parameter_changes
from rig.view.replay_player import Player, ReplayLine
from tests.rig.view.replay_record import GAP_FRAME, LOST_FRAME, RATE_HZ, WITHOUT_FIT, make_record

SECONDS = 100.0
FRAMES = round(SECONDS * RATE_HZ) - 1


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run-1.mcap"
    return make_record(path, SECONDS, overrides=WITHOUT_FIT)


@contextmanager
def replay_of(record: Path, **words: float | bool) -> Iterator[Replay]:
    with RecordReader(record) as reader:
        settings = {"retrack": False, **words}
        yield Replay(reader, recorded_configuration(reader), **settings)  # type: ignore[arg-type]


class Script:
    """Keys, display and clock in one: time goes by only where somebody waits for a key."""

    there = True

    def __init__(self, presses: dict[float, str]) -> None:
        self.now_s = 0.0
        self._presses = sorted(presses.items())
        self.shown: list[tuple[float, RunNow, str | None]] = []
        self.paused: list[bool] = []

    def pressed(self, wait_s: float) -> list[str]:
        self.now_s += wait_s
        keys: list[str] = []
        while self._presses and self._presses[0][0] <= self.now_s:
            keys += self._presses.pop(0)[1].split()
        return keys

    def show(
        self, state: RunNow, length_s: float, remaining_s: float, prompt: str | None, *, paused: bool
    ) -> None:
        self.shown.append((self.now_s, state, prompt))
        self.paused.append(paused)

    def at(self, time_s: float) -> RunNow:
        """What was on the screen at a time."""
        return [state for now_s, state, _ in self.shown if now_s <= time_s][-1]


def played(replay: Replay, speed: float, presses: dict[float, str]) -> tuple[Player, Script]:
    script = Script(presses)
    player = Player(replay, speed, script, script, clock=lambda: script.now_s)  # type: ignore[arg-type]
    player.play()
    return player, script


@pytest.mark.parametrize("speed", [1.0, 10.0, math.inf])
def test_every_pace_gives_the_record_bit_for_bit(record: Path, speed: float) -> None:
    with replay_of(record) as replay:
        _, script = played(replay, speed, {})
        result = replay.finish()
    assert result.comparison.identical
    assert result.comparison.frames == FRAMES
    assert result.comparison.half_cycles.recorded == result.comparison.half_cycles.replayed >= 25
    assert script.now_s == pytest.approx(SECONDS / speed, abs=0.6)
    last = script.shown[-1][1]
    assert (last.frames, last.dropped_frames, last.lost_spots) == (FRAMES, 1, 1)


def test_blocks_of_any_size_give_the_same(record: Path) -> None:
    random = np.random.default_rng(4)
    with replay_of(record) as replay:
        while not math.isinf(replay.next_s):
            replay.advance(math.inf, int(random.integers(1, 90)))
        assert replay.finish().comparison.identical


def test_an_advance_ends_at_the_time_that_is_named(record: Path) -> None:
    with replay_of(record) as replay:
        assert replay.advance(-1.0, 100) is None
        step = replay.advance(0.05, 100)
        assert step is not None
        assert step.sequences.tolist() == [0, 1, 2]
        assert replay.next_s == pytest.approx(0.06)
        assert replay.advance(0.05, 100) is None


def test_a_part_begins_and_ends_where_it_is_told(record: Path) -> None:
    with replay_of(record, from_s=10.0, to_s=40.0) as replay:
        played(replay, math.inf, {})
        result = replay.finish()
    assert replay.partial
    assert sum(map(len, result.deflections)) == 30 * RATE_HZ + 1 - 1
    assert result.dropped_frames == 1
    comparison = result.comparison
    assert (comparison.frames, comparison.spots.changed) == (30 * RATE_HZ, 0)
    # the same turning points, found by a pipeline that began later: within some of their uncertainties
    assert comparison.half_cycles.replayed == comparison.half_cycles.recorded >= 12
    assert comparison.half_cycles.largest_u < 8.0


def test_what_is_replayed_is_said_to_be_the_record(record: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay_record(record, None, retrack=False, overrides=[]) == 0
    said = capsys.readouterr().out
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


def test_angles_are_not_compared_with_px(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A record replayed with the lever that it lacked had half-cycles changed by 1.5 × 10⁵ u."""
    path = make_record(tmp_path / "px.mcap", 20.0, calibrated=False, overrides=WITHOUT_FIT)
    replay_record(path, None, retrack=False, overrides=["lever.arm_m=1.0", "lever.pixel_pitch_m=4.8e-6"])
    said = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("half-cycles"))
    assert "10 " in said
    assert float(re.findall(r"(\S+) u,|$", said)[0] or 0) < 0.1


def test_an_unknown_uncertainty_hides_no_other_change() -> None:
    """NaN for the first of two changes made the comparison say "only in uncertainties or flags"."""
    old = HalfCycle(1, 2_000_000_000, 1e-5, 100.0, math.nan, 2.0, 1e-5, 0.0, 1, 0)
    new = replace(old, turn_time_ns=old.turn_time_ns + 30_000)
    comparison = ReplayComparison(0, is_one_unit=True)
    found = comparison.finish([old], [new], from_start=True, to_end=True).half_cycles
    assert found.largest_u == pytest.approx(3.0)
    rows = np.array(
        [(7, 10.0, math.nan, 20.0, 0.5)],
        dtype=[("sequence", int), *((name, float) for name in ("x_px", "u_x_px", "y_px", "u_y_px"))],
    )
    comparison.spots(rows, [Spot(10.0, 21.0, *[1.0] * 8, 0)])
    spots = comparison.finish([], [], from_start=True, to_end=True).spots
    assert (spots.largest_u, spots.largest_at) == (2.0, 7.0)


def test_the_line_says_how_long_it_will_take() -> None:
    now_s = 0.0
    written = io.StringIO()
    with ReplayLine("arcsec", "keys", stream=written, clock=lambda: now_s) as line:
        for step in range(1, 14):
            now_s = float(step)
            shown = RunNow(elapsed_s=10.0 * step, frames=step, amplitude=80.0)
            line.show(shown, 200.0, 20.0 - now_s, None, paused=False)
    # no terminal: a line every five seconds and no help for keys
    lines = written.getvalue().splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("replaying  50.00 of 200.0 s  25 %  5 frames  0 half-cycles  80.00 arcsec")
    assert lines[0].endswith("about 0:15 left")


def test_keys_pause_step_and_go_on(record: Path) -> None:
    presses = {1.0: "space", 3.0: "n", 4.0: "right", 5.0: "h", 7.0: "space", 8.0: "q"}
    with replay_of(record) as replay:
        player, script = played(replay, 1.0, presses)
    paused = script.at(2.9)
    assert script.paused[[state is paused for _, state, _ in script.shown].index(True)]
    assert paused.elapsed_s == pytest.approx(1.0, abs=0.1)
    assert script.at(3.9).frames == paused.frames + 1
    assert script.at(4.9).frames == paused.frames + 2
    # the first half-cycles come together, when four of them are over
    assert script.at(4.9).half_cycles == 0 < script.at(6.9).half_cycles
    assert script.at(6.9).elapsed_s < 15.0
    assert script.at(7.9).elapsed_s == pytest.approx(script.at(6.9).elapsed_s + 0.9, abs=0.15)
    assert player.ended_by_user


def test_forwards_nothing_is_left_out(record: Path) -> None:
    with replay_of(record) as replay:
        _, script = played(replay, 1.0, {1.0: "+", 2.0: "g 4 9 backspace 8 . 5 enter", 3.0: "g 9 escape"})
        result = replay.finish()
    assert script.at(1.9).elapsed_s == pytest.approx(11.9, abs=0.3)
    assert script.at(2.9).elapsed_s == pytest.approx(49.4, abs=0.3)
    assert [prompt for _, _, prompt in script.shown if prompt is not None] == []
    assert not replay.was_restarted
    assert result.comparison.identical


def test_backwards_the_pipeline_begins_again(record: Path) -> None:
    with replay_of(record) as replay:
        _, script = played(replay, 10.0, {3.0: "space", 3.5: "-", 4.5: "g 5 enter", 5.5: "space"})
        result = replay.finish()
    assert script.at(4.4).elapsed_s == pytest.approx(20.0, abs=0.8)
    assert script.at(5.4).elapsed_s == pytest.approx(5.0, abs=0.05)
    assert script.at(5.4).frames == 0
    assert replay.was_restarted
    assert sum(map(len, result.deflections)) == 95 * RATE_HZ - 1


def test_seeking_beyond_the_ends_stops_there(record: Path) -> None:
    with replay_of(record, to_s=20.0) as replay:
        _, script = played(replay, 1.0, {1.0: "space - ", 2.0: "g 5 0 0 enter"})
    assert script.at(1.9).elapsed_s == 0.0
    assert script.shown[-1][1].elapsed_s == pytest.approx(20.0, abs=0.03)


def test_going_back_is_said_and_not_compared(
    record: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # long enough for thirty seconds to go through, a chunk of the record at a time; then it stands still
    presses: list[list[str]] = [["g", "3", "0", "enter", "space"], *[[]] * 200, ["-"], ["q"]]

    def pressed(_: Keys, wait_s: float) -> list[str]:
        return presses.pop(0) if presses else []

    monkeypatch.setattr(Keys, "pressed", pressed)
    assert replay_record(record, None, retrack=False, overrides=[], speed="1") == 0
    said = capsys.readouterr().out
    assert "by going back: the results are not compared" in said
    assert "equal bit for bit" not in said
    assert "note: replayed from 20.00 s to" in said


def test_windows_that_have_no_spot_do_not_hold_up_the_others(tmp_path: Path) -> None:
    path = make_record(tmp_path / "run.mcap", 20.0, windows=True)
    with replay_of(path, retrack=True) as replay:
        flags: dict[int, int] = {}
        while (step := replay.advance(math.inf, 100)) is not None:
            found = [spot.flags for spot in step.block.spots]
            flags.update(zip(step.sequences.tolist(), found, strict=True))
    tracked = [number for number, flag in flags.items() if not flag & SpotFlag.LOST]
    assert GAP_FRAME not in flags
    assert tracked == [number for number in range(0, 1000, 10) if number not in (GAP_FRAME, LOST_FRAME)]


def test_a_changed_setting_is_compared_with_what_was_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = make_record(tmp_path / "run.mcap", SECONDS)
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
    assert [(change.name, change.change_u) for change in changes] == [
        ("fits.exact.b", 2.0),
        ("friction_moment", 2.0),
    ]


def test_a_number_of_one_part_of_a_decay_is_compared_with_that_of_the_same_part() -> None:
    """A quantity of several parts, or of instrument and any decay, was compared by its last row alone."""

    def run(start: float, whole: float) -> RunResults:
        rows = (("instrument", whole), ("instrument, start", start), ("instrument, end", 3.0), ("decay", 4.0))
        return RunResults(
            record="run-1.mcap",
            table=tuple(
                ResultRow(quantity="log_decrement", fit=fit, value=value, u_total=0.5) for fit, value in rows
            ),
            instrument=InstrumentResults(kind="herbert"),
        )

    changes = parameter_changes(run(2.0, 1.0), run(2.5, 1.5))
    assert [(change.name, change.change_u) for change in changes] == [
        ("log_decrement", 1.0),
        ("log_decrement, start", 1.0),
        ("log_decrement, end", 0.0),
        ("decay.log_decrement", 0.0),
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


@pytest.mark.parametrize("text", ["fast", "0", "-1", "nan", ""])
def test_a_speed_that_is_none(text: str) -> None:
    with pytest.raises(ConfigurationError, match="must be a number above 0, or max"):
        speed_of(text)


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        ({"from_s": -1.0}, ConfigurationError, "must begin before it ends"),
        ({"from_s": 5.0, "to_s": 5.0}, ConfigurationError, "must begin before it ends"),
        (
            {"from_s": 500.0},
            ConfigurationError,
            r"^--from 500: beyond the end of .*, which goes from 0 to 100\.0 s$",
        ),
    ],
)
def test_a_part_that_is_none(
    record: Path, words: dict[str, float], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        replay_record(record, None, retrack=False, overrides=[], **words)  # type: ignore[arg-type]


@pytest.mark.parametrize("pieces", [lambda data: [data], lambda data: [bytes([byte]) for byte in data]])
def test_keys_are_the_same_in_one_piece_and_in_many(pieces: Callable[[bytes], list[bytes]]) -> None:
    parser = KeyParser()
    keys = [key for piece in pieces(b"n \x1b[C\x1b[1;5C\x1bOCg1\r\x7f\x1bq") for key in parser.feed(piece)]
    assert keys == ["n", "space", "right", "right", "g", "1", "enter", "backspace", "escape", "q"]


def test_an_escape_that_stands_alone_is_a_key() -> None:
    parser = KeyParser()
    assert parser.feed(b"\x1b") == []
    assert parser.flush() == ["escape"]
    assert parser.flush() == []
