"""At a terminal of 80 columns every line fits, no number is broken, and NO_COLOR leaves no colour."""

import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest
from rich.cells import cell_len
from rich.console import Console

from rig.terminal import Table, Verdict, print_line, print_tables, print_verdicts
from rig.terminal.printing import folded
from tests.rig.command_line import CONFIGS, SAMPLES, SMALL, set_words
from tests.rig.pseudo_terminal import rig_at_terminal

WIDTH = 80
DEMO = CONFIGS / "demo.toml"
SCREENS = {
    "info": "record info SERIES/run-1.mcap",
    "check": "record check SERIES",
    "fit": "-v fit SERIES -o fitted",
    "fit of laws": "fit SERIES/run-1.mcap -o fitted --law viscous",
    "replay": "replay SERIES/run-1.mcap --retrack --set sensor.read_noise_e=40",
    "plan": f"plan {DEMO} --first 124 --last 30",
    "compare": "compare SERIES other",
    "instruments": "init --instruments",
    "devices": "doctor",
    "doctor": f"doctor {DEMO}",
    "preflight": f"doctor {DEMO} --preflight",
    "balance": f"balance {DEMO} --history --history-file turns.jsonl",
    "camera show": f"camera show {DEMO}",
    "light show": f"light show {DEMO}",
    "calibrate": "calibrate lever geometry.toml",
    "run": f"run {DEMO} -o run --set session.max_duration_s=12 --force",
}
TURN = (
    '{"utc": "2026-11-01T12:00:00", "weight": "x", "turns": [1.0, -0.25], '
    '"before": [10.0, 5.0, 1e-4], "after": [-300.0, 4.0, 1.2e-4], "u": [0.1, 0.1, 1e-6]}\n'
)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCREENS)
def test_every_line_fits(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.delenv("COLUMNS", raising=False)
    shutil.copytree(SAMPLES / "series", tmp_path / "series")
    if "other" in SCREENS[name]:
        shutil.copytree(SAMPLES / "first", tmp_path / "other")
    (tmp_path / "turns.jsonl").write_text(TURN)
    (tmp_path / "geometry.toml").write_text(
        "[geometry]\narm_m = 1.0\nu_arm_m = 0.001\npixel_pitch_m = 4.8e-6\nu_pixel_pitch_m = 1e-9\n"
    )
    words = shlex.split(SCREENS[name].replace("SERIES", "series"))
    if name in ("run", "preflight"):
        words += set_words(SMALL)
    screen = shown(words, tmp_path)
    assert "\x1b[3" not in re.sub(r"\x1b\[3[9m]", "", screen), "a colour"
    for line in lines_of(screen):
        if cell_len(line) > WIDTH:
            # a path is not broken, because it is copied
            assert max(map(len, line.split())) > WIDTH / 2, line
            assert re.search(r"[/\\]", line), line
        assert not re.search(r"\S…", line), f"a broken number: {line}"


def test_a_table_that_is_too_wide_goes_on_below(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("rig.terminal.printing.terminal_columns", lambda _: 40)
    head = ("", *(f"u(q{number})" for number in range(9)))
    row = ["what is measured", *(f"0.123456{number}" for number in range(9))]
    print_tables([Table("wide", "Too wide", head, [row])])
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 40
    assert all(cell in text for cell in row)
    assert text.count("what is measured") > 2
    assert text.count("Too wide") == 1


def test_a_table_without_a_line_for_the_user_is_its_note(capsys: pytest.CaptureFixture[str]) -> None:
    print_tables([Table("d", "Differences", ("", "chance"), [], "None is large.")])
    assert capsys.readouterr().out.split("\n")[:2] == ["Differences", "None is large."]


@pytest.mark.parametrize("bold", [False, True])
def test_numbers_stand_to_the_right_and_headings_are_bold_at_a_terminal(
    bold: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: bold)
    # the wide characters take two places; half of the last column are numbers
    print_tables([Table("t", "", ("no", "value", "u"), [["日本", "1.5", "1"], ["b", "−20", "yy"]])])
    head, *lines = capsys.readouterr().out.splitlines()
    assert head == ("\x1b[1mno    value  u\x1b[0m" if bold else "no    value  u")
    assert lines[:2] == ["日本    1.5  1", "b       −20  yy"]


@pytest.mark.parametrize(
    ("columns", "lines"), [(20, ["r  aa bb  cc ddd e"]), (17, ["r  aa bb  cc", "          ddd e"])]
)
def test_the_widest_column_is_wrapped_first(
    columns: int, lines: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("rig.terminal.printing.terminal_columns", lambda _: columns)
    print_tables([Table("t", "", ("", "x", "y"), [["r", "aa bb", "cc ddd e"]])])
    assert capsys.readouterr().out.splitlines()[1:-1] == lines


LONG = "the friction b is (3.7333 ± 0.0030) × 10⁻³, drag moves it by 29 % of c ± 3 % in all"


def test_a_text_that_just_fits_is_not_folded() -> None:
    assert [folded("ball on K8", columns) for columns in (10, 9)] == ["ball on K8", "ball on\nK8"]


@pytest.mark.parametrize("columns", range(30, 60))
def test_no_line_ends_within_a_number(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("rig.terminal.printing.terminal_columns", lambda _: columns)
    print_line(LONG)
    print_tables([Table("t", "", ("", "text"), [["b", LONG]])])
    print_verdicts(Console(width=columns), [Verdict("b", False, "", remedy=LONG)])
    text = capsys.readouterr().out
    lines = text.splitlines()
    assert max(map(cell_len, lines)) <= columns
    whole = [number for line in lines for number in ("(3.7333 ± 0.0030) × 10⁻³", "29 %") if number in line]
    assert len(whole) == 6


def shown(words: list[str], folder: Path) -> str:
    """What a command writes on a terminal of 80 columns."""
    done = rig_at_terminal(*words, cwd=folder, columns=WIDTH)
    assert done.returncode in (0, 1), done.stdout
    return done.stdout


def lines_of(screen: str) -> list[str]:
    """What stands in the lines, without what moves the cursor."""
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen)
    return [part for line in plain.split("\n") for part in line.rstrip("\r").split("\r")]
