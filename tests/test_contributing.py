"""The worked examples of docs/extending.md run in a copy of the tree, one after the other."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from processing.units import ARCSEC_RAD
from tests.rig.command_line import SMALL, set_words
from tests.rig.view.rrd_contents import measured

pytestmark = pytest.mark.slow
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


def run(tree: Path, command: str) -> str:
    """The output of a command in the copy; the demonstration has small frames."""
    program, *words = shlex.split(command)
    assert program in ("rig", "pytest"), command
    words += set_words(SMALL) if words[:2] == ["run", "configs/demo.toml"] else []
    environment = {**os.environ, "PYTHONPATH": str(tree), "COLUMNS": "200"}
    done = subprocess.run(
        [sys.executable, "-m", program, *words],
        cwd=tree,
        env=environment,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def run_all(tree: Path, title: str) -> dict[str, str]:
    """Output of every command of an example."""
    blocks = BLOCK.findall(examples()[title])
    lines = [line for kind, _, content in blocks if kind == "sh" for line in content.splitlines()]
    assert lines, f"{title}: has no commands"
    return {line: run(tree, line) for line in lines}


def test_a_camera_is_found_and_delivers_frames(tree: Path) -> None:
    said = run_all(tree, "Adding a camera")
    assert "swinging_spot  Swinging spot  serial SW-1" in said["rig doctor"]
    assert "camera.frame_rate_hz = 40.0" in said["rig camera show swinging-spot.toml"]
    assert re.search(r"/spot +8\d\d\n", said["rig record info swinging-spot.mcap"])
    tested = said["pytest tests/acquisition/cameras/test_swinging_spot.py"]
    assert re.search(r"\b1\d passed", tested), tested


def test_a_laser_passes_the_tests_of_lasers(tree: Path) -> None:
    said = run_all(tree, "Adding a laser")
    (tested,) = said.values()
    assert re.search(r"\b1\d passed", tested), tested
    run(tree, "rig camera show laser.toml")


def test_a_quantity_of_the_results_stands_in_every_file(tree: Path) -> None:
    said = run_all(tree, "Adding a quantity of the results")
    assert "1 passed" in said["pytest tests/processing/fit/test_mean_pressure.py"]
    rows = (tree / "runs/pressure-csv/run-1-table.csv").read_text(encoding="utf-8").splitlines()
    (line,) = [row for row in rows if row.startswith('"mean_pressure_pa","exact",')]
    assert '"determined","Pa"' in line


RECORDED = """
from pathlib import Path
from acquisition.record.reader import RecordReader
with RecordReader(Path("balance.mcap")) as record:
    print(*record.table("/balance")["rest_distance_rad"].tolist())
"""
"""Who reads a record has the fields of the version that wrote it."""


def test_a_quantity_of_the_balance_is_recorded_and_drawn(tree: Path) -> None:
    run_all(tree, "Adding a quantity of the balance")
    said = subprocess.run(
        [sys.executable, "-c", RECORDED],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    recorded = np.array([float(word) for word in said.stdout.split()])
    times_s, shown, _ = measured(tree / "balance.rrd", "/balance/rest_distance")
    assert len(times_s) == len(recorded) > 3
    assert shown == pytest.approx(recorded / ARCSEC_RAD)


def test_a_term_of_the_fit_has_its_line_in_the_budget(tree: Path) -> None:
    said = run_all(tree, "Adding a term of the fit")
    assert "1 passed" in said["pytest tests/processing/fit/test_thermal_scale.py"]
    results = (tree / "runs/warming/results.json").read_text(encoding="utf-8")
    assert '"thermal_scale"' in results


def test_a_law_is_fitted(tree: Path) -> None:
    said = run_all(tree, "Adding a law of the contact")
    (tested,) = said.values()
    assert re.search(r"\b[3-9] passed|\b\d\d passed", tested), tested
