"""The example of the model in docs/many-runs.md runs as it is written."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

from tests.rig.command_line import rig
from tests.rig.report.made_sessions import humid_campaign

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "many-runs.md").read_text(encoding="utf-8")
TEXT = PAGE.partition("\n## One model of many runs\n")[2].partition("\n## ")[0]
SAMPLES = Path(__file__).parents[1] / "data" / "samples"


@pytest.mark.slow
def test_the_commands_and_the_file_of_the_page(tmp_path: Path) -> None:
    humid_campaign(tmp_path / "runs")
    ((name, block),) = re.findall(r"^```toml\n# (\S+\.toml)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    (tmp_path / name).write_text(block, encoding="utf-8")
    folders, of_archive = (shlex.split(line) for line in re.findall(r"^ {4}rig (.*)$", TEXT, re.MULTILINE))
    done = rig(*folders, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    tree = json.loads((tmp_path / "campaigns" / "glass" / "campaign.json").read_text())
    assert tree["effects"][0]["margin"] == 0.3
    assert tree["changes"][0]["parameter"] == "c"
    # records with humidities and samples take minutes to measure: the words alone are checked here
    shutil.copytree(SAMPLES / "first", tmp_path / "runs" / "first")
    assert rig("archive", "add", "runs/first", cwd=tmp_path).returncode == 0
    none = rig(*of_archive, cwd=tmp_path)
    assert none.returncode == 2
    assert "no run with results meets it" in none.stderr


def test_forms_and_covariates_that_are_named_exist() -> None:
    from dataclasses import fields

    from processing.ambient import AmbientConditions
    from processing.series import Form

    forms = set(re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE))
    assert forms == set(map(str, Form))
    named = {field.name for field in fields(AmbientConditions)} - {"temperature_change_k"}
    assert all(f"`{name}`" in TEXT for name in named)
