"""The worked examples of docs/extending.md run in a copy of the tree, one after the other."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

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


class Ran(NamedTuple):
    """Exit status, output and errors of every command; what the record of the balance has of its quantity."""

    by_line: dict[str, tuple[int, str, str]]
    distances_rad: list[float]

    def said(self, title: str) -> dict[str, str]:
        """What the commands of an example printed, of which none failed."""
        return {line: self.output(line) for line in commands(title)}

    def output(self, line: str) -> str:
        """What a command printed, which did not fail."""
        status, out, errors = self.by_line[line]
        assert status == 0, f"{line}\n{out[-2000:]}\n{errors[-2000:]}"
        return out


@pytest.fixture(scope="module")
def ran(tree: Path) -> Ran:
    """All commands of the page in the copy; the demonstration has small frames."""
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
    return Ran(dict(zip(lines, done, strict=True)), distances_rad)


def test_a_camera_is_found_and_delivers_frames(ran: Ran) -> None:
    said = ran.said("Adding a camera")
    assert "swinging_spot  Swinging spot  serial SW-1" in said["rig doctor"]
    assert "camera.frame_rate_hz = 40.0" in said["rig camera show swinging-spot.toml"]
    assert re.search(r"/spot +8\d\d\n", said["rig record info swinging-spot.mcap"])
    tested = said["pytest tests/acquisition/cameras/test_swinging_spot.py"]
    assert re.search(r"\b1\d passed", tested), tested


def test_a_laser_passes_the_tests_of_lasers(ran: Ran) -> None:
    (tested,) = ran.said("Adding a laser").values()
    assert re.search(r"\b1\d passed", tested), tested
    ran.output(BESIDE)


def test_a_quantity_of_the_results_stands_in_every_file(tree: Path, ran: Ran) -> None:
    said = ran.said("Adding a quantity of the results")
    assert "1 passed" in said["pytest tests/processing/fit/test_mean_pressure.py"]
    rows = (tree / "runs/pressure-csv/run-1-table.csv").read_text(encoding="utf-8").splitlines()
    (line,) = [row for row in rows if row.startswith('"mean_pressure_pa","exact",')]
    assert '"determined","Pa"' in line


def test_a_quantity_of_the_balance_is_recorded_and_drawn(tree: Path, ran: Ran) -> None:
    assert ran.said("Adding a quantity of the balance")
    recorded = np.array(ran.distances_rad)
    times_s, shown, _ = measured(tree / "balance.rrd", "/balance/rest_distance")
    assert len(times_s) == len(recorded) > 3
    assert shown == pytest.approx(recorded / ARCSEC_RAD)


def test_a_term_of_the_fit_has_its_line_in_the_budget(tree: Path, ran: Ran) -> None:
    said = ran.said("Adding a term of the fit")
    assert "1 passed" in said["pytest tests/processing/fit/test_thermal_scale.py"]
    results = (tree / "runs/warming/results.json").read_text(encoding="utf-8")
    assert '"thermal_scale"' in results


def test_a_law_is_fitted(ran: Ran) -> None:
    (tested,) = ran.said("Adding a law of the contact").values()
    assert re.search(r"\b[3-9] passed|\b\d\d passed", tested), tested
