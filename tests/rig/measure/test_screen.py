"""Screen and JSON lines during a run: age of frames, losses by cause."""

import io
import json
import math
import re
import sys
from dataclasses import asdict, astuple, replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from acquisition.frames.losses import FrameLosses
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import RecordedClockStep, RecordedLosses
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from processing.units import ARCSEC_RAD
from rig.instrument.run_now import CameraClock, Phase, RecordContents, RunNow
from rig.measure import screen as screen_module
from rig.measure.run_status import estimate_rows, estimate_texts
from rig.measure.screen import RunDisplay
from tests.rig.made_up import balance_of, half_cycle

RAD = DeflectionUnit.RAD
SEEN = RunNow(
    phase=Phase.MEASURING,
    frames=1000,
    dropped_frames=4,
    frame_age_s=0.0123,
    losses=FrameLosses(by_bus=3, by_host=1),
    estimates={"c": Estimate(1e-8, math.inf)},
    clock=CameraClock(31.204, 0.052, 1, 0.13),
)
MEASURING = RunNow(phase=Phase.MEASURING, amplitude=124.0)


def display(unit: DeflectionUnit = RAD, **more: Any) -> RunDisplay:
    return RunDisplay("run 1", 2.0, unit, console=Console(file=io.StringIO(), width=118, height=40), **more)


def screen(now: RunNow, shown: RunDisplay | None = None, **console: Any) -> str:
    output = io.StringIO()
    Console(file=output, width=118, height=40, **console).print((shown or display()).screen(now))
    return output.getvalue()


def test_a_closed_stdout_takes_further_lines_and_ends_no_measurement(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def closed(*_: object) -> None:
        raise BrokenPipeError

    path = tmp_path / "stdout"
    with path.open("w") as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        monkeypatch.setattr(screen_module, "print_json_line", closed)
        display(json_lines=True).line("state", {})
        # what was buffered before goes nowhere, and raises no error at the end of the program
        print("buffered", flush=True)
    assert path.read_text() == ""


SWINGING = RunNow(Phase.MEASURING, elapsed_s=50.0, amplitude=123.0, amplitude_s=38.0, period_s=4.1)


@pytest.mark.parametrize(
    ("now", "unit", "said", "unsaid"),
    [
        (SEEN, RAD, ("age 12 ms", "4 frames dropped", "3 by the bus, 1 by this computer"), "counted from"),
        (RunNow(phase=Phase.MEASURING), RAD, ("age -",), "none"),
        # before the record no loss is counted, and none is denied
        (RunNow(phase=Phase.REST, frames=10), RAD, ("counted from the record on",), "0 frames dropped"),
        (RunNow(phase=Phase.WARM_UP, frames=10), RAD, ("counted from the record on",), "0 frames dropped"),
        (RunNow(phase=Phase.REST, frame_age_s=0.01), RAD, ("counted from the record on",), "0 in all"),
        (MEASURING, RAD, ("124.000 arcsec", "to 2 arcsec"), " px"),
        # the final amplitude is configured in arcsec: amplitudes in px never reach it
        (MEASURING, DeflectionUnit.PX, ("124.000 px", "unknown: no lever"), "arcsec"),
        (MEASURING, DeflectionUnit.PX, (), "to 2"),
        # a pendulum that was stopped, or leaves the sensor, keeps its last amplitude
        (SWINGING, RAD, (), "no swing"),
        (replace(SWINGING, elapsed_s=51.0), RAD, ("123.000 arcsec (no swing for 13 s)",), "none"),
        (RunNow(Phase.REST, "spread 3.00 arcsec of 1"), RAD, ("rest: spread 3.00",), "none"),
        (SEEN, RAD, ("+31.204 ± 0.052 ppm against the computer's",), "none"),
        # it was 1:60.0: the seconds were rounded after the minutes had been taken from them
        (replace(SEEN, elapsed_s=119.97), RAD, ("2:00.0, ",), "60.0"),
    ],
)
def test_the_screen_says(now: RunNow, unit: DeflectionUnit, said: tuple[str, ...], unsaid: str) -> None:
    shown = screen(now, display(unit))
    assert all(text in shown for text in said)
    assert unsaid not in shown


def test_steps_of_a_clock_are_counted_and_the_largest_is_said() -> None:
    now = RunNow()
    for step_ns in (20_000_000, -130_000_000, 4_000_000):
        step = RecordedClockStep(1, step_ns, 1000)
        now = now.with_contents(RecordContents(messages=[step]), RAD)
    assert now.clock == CameraClock(steps=3, largest_step_s=-0.13)


def test_a_new_record_begins_with_what_the_rig_says_and_no_value_of_the_rejected_start() -> None:
    names = ("light", "interlock", "trip", "darkness", "controller", "alarm")
    of_rig: dict[str, Any] = {
        "temperature_c": 21.5,
        "humidity_percent": 45.0,
        "pressure_pa": 99e3,
        **{n: n for n in names},
    }
    assert replace(SWINGING, **of_rig).for_new_record() == RunNow(Phase.MEASURING, **of_rig)


def test_what_a_record_holds_adds_up_and_flagged_half_cycles_have_no_amplitude() -> None:
    first, second = (
        half_cycle(n, size * ARCSEC_RAD, 2.1, late_s=10.0) for n, size in enumerate((124.0, 99.0))
    )
    half_cycles = [first, replace(second, flags=1)]
    before = RunNow(half_cycles=5, dropped_frames=7)
    lost = [RecordedLosses(1, *astuple(FrameLosses(by_bus=count))) for count in (9, 3)]
    for losses, dropped in zip(lost, (9, 7), strict=True):
        contents = RecordContents(half_cycles=half_cycles, messages=[losses], start_ns=6_000_000_000)
        now = before.with_contents(contents, RAD)
        assert (now.half_cycles, now.dropped_frames) == (7, dropped)
        assert (now.amplitude, now.amplitude_s, now.period_s) == (pytest.approx(124.0), 4.0, 4.2)


def test_the_panel_has_the_alarm_and_the_newest_events() -> None:
    shown = display()
    shown.take(RecordContents(events=[Event(n, EventKind.STOP, f"number {n}.") for n in range(20)]))
    seen = screen(SEEN, shown)
    assert "number 19." in seen
    assert "number 0." not in seen
    assert "!!!" not in seen
    assert "!!! IT IS DARK !!!" in screen(replace(SEEN, alarm="it is dark"), shown)


def test_a_line_is_printed_when_the_phase_changes_and_not_for_its_progress() -> None:
    shown = display(json_lines=True)
    lines: list[dict[str, Any]] = []
    shown.line = lambda _, values: lines.append(values)  # type: ignore[method-assign]
    for progress in ("spread 3.00 arcsec of 1", "spread: 2.00 arcsec of 1", ""):
        shown.show(RunNow(Phase.REST, progress))
    shown.show(RunNow(Phase.RELEASE))
    assert [(line["phase"], line["progress"]) for line in lines] == [
        ("rest", "spread 3.00 arcsec of 1"),
        ("release", ""),
    ]


def test_the_screen_has_the_phases_of_a_run_in_their_order_and_marks_the_present_one() -> None:
    shown = display(phases=(Phase.REST, Phase.WARM_UP, Phase.RELEASE))
    now = RunNow(Phase.WARM_UP, "drift 0.30 arcsec/min (limit 0.1)")
    coloured = screen(now, shown, force_terminal=True, color_system="standard")
    plain = re.sub(r"\x1b\[[0-9;]*m", "", coloured)
    assert "rest > warm-up > release > recording" in plain
    assert "warm-up: drift 0.30 arcsec/min (limit 0.1)" in plain
    assert re.search(r"\x1b\[1;36mwarm-up", next(x for x in coloured.splitlines() if "recording" in x))


@pytest.mark.parametrize(("longest_s", "is_limit"), [(100.0, True), (7200.0, False)])
def test_the_time_left_is_to_the_end_that_comes_first(longest_s: float, is_limit: bool) -> None:
    """Of a decay from 124 arcsec by 1 % a half-cycle, after a minute."""
    shown = display(max_duration_s=longest_s)
    shown.take(RecordContents(half_cycles=[half_cycle(n, 124 * 0.99**n * ARCSEC_RAD) for n in range(30)]))
    seen = RunNow(phase=Phase.MEASURING, elapsed_s=60.0, amplitude=92.6)
    shown.show(seen)
    values = shown.values(seen)
    assert values["at_most_s"] == longest_s - 60.0
    if is_limit:
        assert (values["remaining_s"], values["u_remaining_s"], values["done"]) == (40.0, 0.0, 0.6)
        assert "to the time limit" in screen(seen, shown)
    else:
        # ln(124/2)/ln(1/0.99) half-cycles of 2 s, less the minute, and 2.5 more that end a run
        assert values["remaining_s"] == pytest.approx(821.3 - 60.0 + 5.0, rel=0.1)
        assert 0.5 < values["u_remaining_s"] < 60.0
        assert "to 2 arcsec" in screen(seen, shown)
        assert shown.values(replace(seen, amplitude=math.sqrt(92.6 * 2.0)))["done"] == pytest.approx(0.5)


def test_before_the_amplitude_tells_the_end_the_limit_is_said() -> None:
    shown = display(max_duration_s=300.0)
    assert "too early to say, at most 4:00" in screen(RunNow(phase=Phase.MEASURING, elapsed_s=60.0), shown)


@pytest.mark.parametrize(("unit", "size"), [(DeflectionUnit.PX, 1.0), (RAD, ARCSEC_RAD)])
def test_the_screen_shows_the_balance_in_its_own_unit(unit: DeflectionUnit, size: float) -> None:
    places = {"transverse": 2.5 * size, "rest_x": -0.0004 * size, "rest_y": -1.5 * size}
    balance = balance_of(unit, transverse_ratio=1e-3, line_angle_rad=1e-3, **places)
    shown = screen(replace(SEEN, balance=balance), display(unit))
    assert f"2.500 {unit.shown} (0.10 %)" in shown
    assert f"X +0.000, Y −1.500 {unit.shown}" in shown


def test_json_lines_name_each_loss_and_how_the_camera_s_clock_runs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    display(json_lines=True).show(SEEN)
    state = json.loads(capsys.readouterr().out.splitlines()[0])
    assert state["frame_age_s"] == 0.0123
    assert state["amplitude_unit"] == "arcsec"
    assert state["losses"] == asdict(SEEN.losses)
    assert state["estimates"] == {"c": {"value": 1e-8, "standard_uncertainty": None}}
    assert state["clock"] == {"drift_ppm": 31.204, "u_drift_ppm": 0.052, "steps": 1, "largest_step_s": 0.13}
    assert display().values(replace(SWINGING, elapsed_s=51.0))["no_swing_s"] == 13.0


def test_a_value_that_its_uncertainty_hides_is_not_shown() -> None:
    assert estimate_texts("c", Estimate(-0.9e-8, 2.2e-8)) == ("not yet seen", "")
    value, relative = estimate_texts("p", Estimate(0.932, 0.013))
    assert value.startswith("0.932")
    assert relative == "1.4 %"


def test_the_page_is_told_what_it_has_no_place_for() -> None:
    found = display()
    seen = replace(MEASURING, estimates={"c": Estimate(1e-8, 1e-10)})
    assert dict(found.rows(replace(seen, record_bytes=2_500_000)))["record"].endswith(" MB/s, 2.5 MB")
    names, facts = ([name for name, _ in rows] for rows in (found.rows(seen), found.facts(seen)))
    assert "amplitude" in names
    assert set(names) - set(facts) >= {"amplitude", *(name for name, _ in estimate_rows(seen, ()))}
    assert {"losses", "record", "disk", "environment"} <= set(facts)
    assert facts == [name for name in names if name in facts]


def test_the_rates_are_those_of_the_last_seconds() -> None:
    """A camera that slows down after minutes would hardly change a mean over the whole run."""
    shown, found = display(), []
    for second in range(121):
        frames = 100 * min(second, 100) + 20 * max(second - 100, 0)
        now = replace(SEEN, elapsed_s=float(second), frames=frames, record_bytes=10 * frames)
        found.append(shown.values(now))
    assert [found[at]["frames_hz"] for at in (0, 50, 120)] == [0.0, pytest.approx(100), pytest.approx(20)]
    assert found[120]["record_bytes_per_s"] == pytest.approx(200)
    again = shown.values(replace(SEEN, elapsed_s=0.0, frames=1))
    assert again["frames_hz"] == 0.0, "of a new record"
