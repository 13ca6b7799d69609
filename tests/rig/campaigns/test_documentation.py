"""The example of docs/campaign.md runs as it is written."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

from rig.settings import decides, load_configuration, load_deciding_plan, load_plan
from tests.rig.campaigns.made_sessions import humid_campaign
from tests.rig.command_line import rig

ROOT = Path(__file__).resolve().parents[3]
TEXT = (ROOT / "docs" / "campaign.md").read_text(encoding="utf-8")
SAMPLES = Path(__file__).parents[1] / "data" / "samples"


@pytest.mark.slow
def test_the_commands_and_the_file_of_the_page(tmp_path: Path) -> None:
    humid_campaign(tmp_path / "runs")
    ((name, block),) = re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    (tmp_path / name).write_text(block, encoding="utf-8")
    folders, of_archive, *_ = (
        shlex.split(line) for line in re.findall(r"^ {4}rig (.*)$", TEXT, re.MULTILINE)
    )
    done = rig(*folders, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    tree = json.loads((tmp_path / "campaigns" / "glass" / "campaign.json").read_text())
    assert tree["effects"][0]["margin"] == 0.3
    assert tree["changes"][0]["parameter"] == "c"
    # records with humidities and samples take minutes to measure: the words alone are checked here
    shutil.copytree(SAMPLES / "first", tmp_path / "runs" / "first")
    assert rig("archive", "add", "runs/first", "--archive", "archive", cwd=tmp_path).returncode == 0
    none = rig(*of_archive, cwd=tmp_path)
    assert none.returncode == 2
    assert "no run with results meets it" in none.stderr


@pytest.mark.slow
def test_the_plans_of_the_page(tmp_path: Path) -> None:
    """The plan that is written is one that a night takes; what it measures is in its words."""
    humid_campaign(tmp_path / "runs")
    ((name, block),) = re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    (tmp_path / name).write_text(block, encoding="utf-8")
    for config in ("basement.toml", "demo.toml"):
        shutil.copy(ROOT / "configs" / config, tmp_path)
    commands = [shlex.split(line) for line in re.findall(r"^ {4}rig (.*)$", TEXT, re.MULTILINE)]
    chosen, measured, forms, night = commands[2:]
    done = rig(*chosen, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    plan = load_plan(tmp_path / measured[measured.index("--plan") + 1])
    (asked,) = {series.config for series in plan.series}
    assert asked.resolve() == (tmp_path / "basement.toml").resolve()
    for series in plan.series:
        session = load_configuration(series.config, series.overrides()).session
        assert series.runs == session.runs
        assert (session.initial_amplitude_arcsec, session.final_amplitude_arcsec) in {
            (124.0, 8.0), (124.0, 4.0), (60.0, 8.0), (60.0, 4.0),
        }  # fmt: skip
    runs = sum(series.runs or 0 for series in plan.series)
    assert f"{runs} runs (" in done.stdout
    deciding = load_deciding_plan(tmp_path / night[night.index("--plan") + 1])
    assert (deciding.targets, deciding.first_arcsec, deciding.last_arcsec) == (
        ("u(c)/c<0.3",), (124.0, 60.0), (8.0, 4.0),
    )  # fmt: skip
    assert 0 < deciding.hours <= 20
    told = rig(*forms, cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    assert "After 6 runs" in told.stdout


def test_the_night_of_the_page_is_one(tmp_path: Path) -> None:
    (block,) = re.findall(r"^```toml\n(# a night that decides\n.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    (tmp_path / "auto.toml").write_text(block, encoding="utf-8")
    plan = load_deciding_plan(tmp_path / "auto.toml")
    assert plan.max_runs == 12
    assert decides(tmp_path / "auto.toml")


def test_forms_and_covariates_that_are_named_exist() -> None:
    from dataclasses import fields

    from processing.campaign import Form
    from processing.surroundings import Surroundings

    forms = set(re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE))
    assert forms == set(map(str, Form))
    named = {field.name for field in fields(Surroundings)} - {"temperature_change_k"}
    assert all(f"`{name}`" in TEXT for name in named)
