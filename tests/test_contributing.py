"""The worked examples of docs/extending.md run in a copy of the tree, one after the other."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from processing.units import ARCSEC_RAD
from tests.rig.command_line import SMALL, set_words
from tests.rig.view.rrd_contents import measured

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
ROOT = Path(__file__).resolve().parents[1]
COPIED = ("rig", "acquisition", "calibration", "processing", "tests", "configs")
BLOCK = re.compile(r"^```(\w+)(?: ([^\n]+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def examples() -> dict[str, str]:
    """The text of each example by its title."""
    text = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    found = re.split(r"^## (.*)$", text, flags=re.MULTILINE)[1:]
    return dict(zip(found[::2], found[1::2], strict=True))


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tree with the files of all examples, a session, and the compiled kernels."""
    copy = tmp_path_factory.mktemp("copy")
    for name in COPIED:
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("data"))
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, copy)
    shutil.copytree(ROOT / "tests" / "rig" / "data" / "samples" / "first", copy / "runs" / "first")
    for text in examples().values():
        for _, place, content in BLOCK.findall(text):
            if place:
                put(copy, place, content)
    return copy


def put(copy: Path, place: str, content: str) -> None:
    """Make a file, or add lines to one below the line with a text (`FILE, after "TEXT"`)."""
    name, _, text = place.partition(", after ")
    path = copy / name
    if not text:
        assert not path.exists(), f"{name} is there already"
        path.write_text(content, encoding="utf-8")
        return
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    found = [row for row, line in enumerate(lines) if text.strip('"') in line]
    assert len(found) == 1, f"{name}: {len(found)} lines with {text}"
    lines.insert(found[0] + 1, content)
    path.write_text("".join(lines), encoding="utf-8")


def commands(title: str) -> list[str]:
    """The command lines of an example."""
    blocks = BLOCK.findall(examples()[title])
    return [line for kind, _, content in blocks if kind == "sh" for line in content.splitlines()]


FEWER = {"tests/processing/test_balance.py": ["-k", "one_estimate or blocks or lost"]}
"""Of a file whose tests all run in the suite."""
BESIDE = "rig camera show laser.toml"
"""The configuration that an example shows beside its commands."""
BALANCE = "balance.mcap"
PROGRAM = """
import contextlib, io, json, sys
from pathlib import Path
import pytest
from acquisition.record.reader import RecordReader
from tests.rig.command_line import rig, verdicts_are_made

def ran(program, *words):
    if program == "rig":
        one = rig(*words)
        return one.returncode, one.stdout, one.stderr
    with contextlib.redirect_stdout(io.StringIO()) as out:
        status = int(pytest.main(list(words)))
    return status, out.getvalue(), ""

with verdicts_are_made(False):
    done = [ran(*words) for words in json.load(sys.stdin)]
with RecordReader(Path("balance.mcap")) as record:
    distances_rad = record.table("/balance")["rest_distance_rad"].tolist()
print(json.dumps([done, distances_rad]))
"""
"""Commands one after the other: a process for each would spend most of its time on imports.

Who reads a record has the fields of the version that wrote it.
"""


@pytest.fixture(scope="module")
def ran(tree: Path) -> dict[str, Any]:
    """What each command of the page printed in the copy, and under BALANCE what it has recorded.

    The demonstration has small frames.
    """
    lines = [*(line for title in examples() for line in commands(title)), BESIDE]
    words = [shlex.split(line) for line in lines]
    assert {program for program, *_ in words} == {"rig", "pytest"}
    small = set_words(SMALL)
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        input=json.dumps(
            [[*line, *(small if "configs/demo.toml" in line else FEWER.get(line[-1], []))] for line in words]
        ),
        timeout=590,
        check=False,
    )
    assert process.returncode == 0, process.stderr[-2000:]
    done, distances_rad = json.loads(process.stdout.splitlines()[-1])
    for line, (status, out, errors) in zip(lines, done, strict=True):
        assert status == 0, f"{line}\n{out[-2000:]}\n{errors[-2000:]}"
    return {**{line: out for line, (_, out, _) in zip(lines, done, strict=True)}, BALANCE: distances_rad}


def test_a_camera_is_found_and_delivers_frames(ran: dict[str, Any]) -> None:
    assert "swinging_spot  Swinging spot  serial SW-1" in ran["rig doctor"]
    assert "camera.frame_rate_hz = 40.0" in ran["rig camera show swinging-spot.toml"]
    assert re.search(r"/spot +8\d\d\n", ran["rig record info swinging-spot.mcap"])


@pytest.mark.parametrize(
    ("title", "passed"),
    [
        ("Adding a camera", r"1\d passed"),
        ("Adding a laser", r"1\d passed"),
        ("Adding a quantity of the results", "1 passed"),
        ("Adding a term of the fit", "1 passed"),
        ("Adding a law of the contact", r"([3-9]|\d\d) passed"),
    ],
)
def test_what_is_added_passes_its_tests(ran: dict[str, Any], title: str, passed: str) -> None:
    (line,) = [line for line in commands(title) if line.startswith("pytest ")]
    assert re.search(rf"\b{passed}", ran[line]), ran[line]


def test_a_quantity_of_the_results_stands_in_every_file(tree: Path, ran: dict[str, Any]) -> None:
    rows = (tree / "runs/pressure-csv/run-1-table.csv").read_text(encoding="utf-8").splitlines()
    (line,) = [row for row in rows if row.startswith('"mean_pressure_pa","exact",')]
    assert '"determined","Pa"' in line


def test_a_quantity_of_the_balance_is_recorded_and_drawn(tree: Path, ran: dict[str, Any]) -> None:
    recorded = np.array(ran[BALANCE])
    times_s, shown, _ = measured(tree / "balance.rrd", "/balance/rest_distance")
    assert len(times_s) == len(recorded) > 3
    assert shown == pytest.approx(recorded / ARCSEC_RAD)


def test_a_term_of_the_fit_has_its_line_in_the_budget(tree: Path, ran: dict[str, Any]) -> None:
    assert '"thermal_scale"' in (tree / "runs/warming/results.json").read_text(encoding="utf-8")
