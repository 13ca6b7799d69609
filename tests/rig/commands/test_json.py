"""``--json``: every command has it, and with it stdout is JSON and nothing else."""

import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer

from acquisition.camera import PluggedCamera
from rig.cli import app
from tests.rig.command_line import CONFIGS, SAMPLES, SMALL, rig, set_words
from tests.rig.commands.wrong_inputs import commands

WITHOUT = {
    "desk": "serves a page until it is ended",
}
"""Commands that print no results, and why."""
IN_LINES = {"run", "demo", "balance", "doctor", "doctor of devices", "preflight"}
"""Commands that tell as they go: one JSON object a line."""
DEMO = CONFIGS / "demo.toml"
RUNS: dict[str, str] = {
    "init": "init mine.toml --example demo",
    "replay": "replay SERIES/run-1.mcap -o again",
    "view": "view SERIES/run-1.mcap --rrd seen.rrd",
    "balance": f"balance {DEMO} --history",
    "doctor": f"doctor {DEMO}",
    "doctor of devices": "doctor",
    "preflight": f"doctor {DEMO} --preflight",
    "record info": "record info SERIES",
    "record check": "record check SERIES",
    "record recover": "record recover SERIES/run-1.mcap",
    "fit": "fit SERIES -o fitted",
    "plan": f"plan {DEMO} --first 124 --last 30",
    "instruments": "init --instruments",
    "film": "fit film --rate 20 --pixel '1 mm' -o film-fit",
    "report": "report SERIES -o page.html",
    "export": "export SERIES -o csv",
    "compare": "compare SERIES other -o campaign",
    "calibrate lever": "calibrate lever geometry.toml",
    "camera show": f"camera show {DEMO}",
    "camera snap": f"camera snap {DEMO} -o spot.png",
    "camera frames": f"camera frames {DEMO} -o level",
    "camera align": f"camera align {DEMO} --seconds 0.3",
    "camera expose": f"camera expose {DEMO}",
    "light show": f"light show {DEMO}",
}
NOT_RUN = {
    "run": "its lines are tested in tests/rig/measure",
    "demo": "is run",
    "paper": "takes minutes; test_paper.py",
    "light acknowledge": "needs a trip; test_light.py",
    "light off": "needs a laser; test_light.py",
    **{
        f"calibrate {kind}": "all kinds are one function, which calibrate lever runs"
        for kind in ("axes", "sensor", "clock", "shutter", "air", "pointing", "check")
    },
}
COMMANDS = {
    " ".join(words): command
    for words, command in commands(typer.main.get_command(app))
    if words[0] != "archive"
}


def test_every_command_has_it() -> None:
    without = {name for name, command in COMMANDS.items() if not _has_json(command)}
    assert without == set(WITHOUT)
    assert {*RUNS, *NOT_RUN, *WITHOUT} - {
        "doctor of devices",
        "preflight",
        "instruments",
        "film",
        "model",
    } == set(COMMANDS)


def _has_json(command: Any) -> bool:
    return any("--json" in item.opts for item in command.params)


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_stdout_is_json_and_nothing_else(name: str, tmp_path: Path) -> None:
    _inputs(name, tmp_path)
    words = shlex.split(RUNS[name].replace("SERIES", "series"))
    small = set_words(SMALL)
    done = rig(*words, "--json", *(small if words[0] == "camera" else ()), cwd=tmp_path)
    assert done.returncode in (0, 1), done.stderr
    if name in IN_LINES and "--history" not in words:
        told = [json.loads(line) for line in done.stdout.splitlines()]
        assert told
        assert all("kind" in one for one in told)
    else:
        found = json.loads(done.stdout)
        assert found
        assert all((tmp_path / path).exists() for path in found.get("written", []))
    if "-o" in words:
        assert found["written"]
    if name == "fit":
        kept = json.loads((tmp_path / "fitted" / "results.json").read_text())
        assert found["results"]["runs"][0]["fits"] == kept["runs"][0]["fits"]


def test_an_error_leaves_stdout_empty(tmp_path: Path) -> None:
    (tmp_path / "noise.mcap").write_bytes(bytes(range(256)))
    done = rig("record", "info", "noise.mcap", "--json", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("rig: ")


def _inputs(name: str, folder: Path) -> None:
    shutil.copytree(SAMPLES / "series", folder / "series")
    if name == "compare":
        shutil.copytree(SAMPLES / "first", folder / "other")
    if name == "calibrate lever":
        (folder / "geometry.toml").write_text(
            "[geometry]\narm_m = 1.0\nu_arm_m = 0.001\npixel_pitch_m = 4.8e-6\nu_pixel_pitch_m = 1e-9\n"
        )
    if name == "film":
        (folder / "film").mkdir()
        rows, columns = np.mgrid[:40, :60]
        for number in range(300):
            time_s = number / 20
            x_px = 30 + 20 * np.exp(-0.05 * time_s) * np.cos(2 * np.pi * time_s)
            light = np.exp(-((columns - x_px) ** 2 + (rows - 20) ** 2) / 18)
            image = np.rint(5 + 200 * light).astype(np.uint8)
            assert cv2.imwrite(str(folder / "film" / f"{number:03d}.png"), image)


def test_the_page_names_the_keys_of_a_camera() -> None:
    page = (CONFIGS.parent / "docs" / "scripts.md").read_text(encoding="utf-8")
    assert ", ".join(f"`{key}`" for key in PluggedCamera._fields) in page


@pytest.mark.slow
def test_the_lines_of_the_page_run(tmp_path: Path) -> None:
    page = (CONFIGS.parent / "docs" / "scripts.md").read_text(encoding="utf-8")
    lines = [
        line.split()[1:] for line in page.splitlines() if line.startswith("    rig ") and "--json" in line
    ]
    assert len(lines) == 2
    (tmp_path / "runs" / "first").mkdir(parents=True)
    shutil.copy(SAMPLES / "first" / "run-1.mcap", tmp_path / "runs" / "first")
    for words in lines:
        assert json.loads(rig(*words, cwd=tmp_path).stdout)
