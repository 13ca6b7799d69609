"""`rig plan --for`: what it asks, refuses and writes."""

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from processing.angle import ARCSEC_RAD
from processing.errors import ConfigurationError
from processing.fit import Conditions
from rig.campaigns import (
    AskedPlan,
    NamedRuns,
    PlannedCampaign,
    StatedCampaign,
    Within,
    campaign_plan_files,
    campaign_plan_table,
    plan_campaign,
    read_target,
    runs_of_folders,
)
from rig.plan import Expected
from rig.settings import load_configuration, load_deciding_plan, load_plan
from tests.processing.fit.decays import paper_pair
from tests.rig.campaigns.made_sessions import humid_campaign
from tests.rig.command_line import CONFIGS, rig

STATED = StatedCampaign(
    size={"b": 0.01, "p": 0.001, "c": 0.1, "period0_s": 1e-4, "gamma_pa": 0.01, "n": 0.01}
)
WITHIN = Within(
    first_arcsec=[124.0, 60.0], last_arcsec=[15.0, 2.0], waits_s=[0.0], samples=["K8"], ready_s=60.0
)


def planned(
    text: str, within: Within = WITHIN, *, noise: float = 0.01, stated: StatedCampaign = STATED
) -> PlannedCampaign:
    parameters, pendulum = paper_pair("glass_k8")
    names = ("b", "p", "c", "n", "period0_s", "gamma_pa")
    values = {name: float(getattr(parameters, name)) for name in names}
    u_rad = noise * ARCSEC_RAD
    expected = Expected(values, pendulum, Conditions(u_rad, u_rad))
    return plan_campaign(expected, stated, [read_target(text, stated)], within)


def asked(overrides: Sequence[str] = ()) -> AskedPlan:
    return AskedPlan(
        source=CONFIGS / "demo.toml", targets=["u(c)/c<0.06"], first_arcsec=[124.0], last_arcsec=[2.0],
        overrides=overrides,
    )  # fmt: skip


def test_a_plan_is_one_of_a_night(tmp_path: Path) -> None:
    found = planned("u(c)/c<0.06")
    assert found.choice.reached
    # also where what the plan sets was set before
    overrides = ["session.operator=me", "session.sample=another"]
    written = campaign_plan_files(found, asked(overrides), NamedRuns([tmp_path / "monday"]), tmp_path)
    for name, text in written.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    plan = load_plan(tmp_path / "plan.toml")
    assert sum(series.runs or 0 for series in plan.series) == len(found.choice.runs)
    measured = []
    for series in plan.series:
        session = load_configuration(series.config, series.overrides()).session
        assert (session.sample, session.operator) == ("K8", "me")
        measured += [(session.initial_amplitude_arcsec, session.final_amplitude_arcsec)] * session.runs
    kinds = [found.kind(one.candidate) for one in found.choice.runs]
    assert measured == [(kind.first_arcsec, kind.last_arcsec) for kind in kinds]
    night = load_deciding_plan(tmp_path / "auto.toml")
    assert night.targets == ("u(c)/c<0.06",)
    assert [path.resolve() for path in night.after] == [tmp_path / "monday"]
    assert night.max_runs > len(found.choice.runs)
    assert load_configuration(night.config, night.set).session.operator == "me"
    table = campaign_plan_table(found)
    assert len(table.rows) == len(measured)
    assert "bring it to" in table.note


def test_of_several_samples_each_stretch_is_a_plan_of_its_own(tmp_path: Path) -> None:
    found = planned("u(b)/b<0.01", replace(WITHIN, samples=["K8", 'steel "2"']))
    files = campaign_plan_files(found, asked(), NamedRuns(), tmp_path)
    samples = [found.kind(one.candidate).sample for one in found.choice.runs]
    assert set(samples) == {"K8", 'steel "2"'}
    assert len(files) == 1 + sum(a != b for a, b in pairwise(samples))
    seen = []
    for text in files.values():
        for series in tomllib.loads(text)["series"]:
            path = tmp_path / series["config"]
            seen += [load_configuration(path, series["set"]).session.sample] * series["runs"]
    assert seen == samples


def test_what_cannot_be_reached_is_said(tmp_path: Path) -> None:
    found = planned("u(c)/c<0.05", replace(WITHIN, longest_s=2000.0), noise=0.05)
    assert not found.choice.reached
    assert found.choice.rig_time_s <= 2000.0
    assert "not enough" in campaign_plan_table(found).note


def test_runs_that_were_made_count(tmp_path: Path) -> None:
    folders = humid_campaign(tmp_path / "runs")
    done = rig(
        "plan", CONFIGS / "basement.toml", "--for", "u(c)/c<0.9", "--after", folders[0], "--first", "124",
        "--last", "4", "-o", tmp_path / "plans",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "No further runs are needed: after 6 runs" in done.stdout
    assert not (tmp_path / "plans" / "plan.toml").exists()
    assert len(runs_of_folders(folders)) == 12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u(c)<0.05", r"must read u\(NAME\)/NAME < NUMBER.*or name two forms"),
        ("u(x)/x<0.05", "no parameter x"),
        ("c: linear over order or nothing", "should be two of 'nothing' and the campaign's forms"),
        ("nothing or nothing", "should be two of"),
    ],
)
def test_a_target_that_is_none_is_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        read_target(text, STATED)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--hours", "3"], "--hours: has no effect without --for"),
        (["--for", "u(c)/c<0.1", "--runs", "3"], "--runs: --for chooses how many"),
        (["--for", "u(c)/c<0.1", "--sample", "a", "--sample", "b", "--after", "runs"], "plan each alone"),
    ],
)
def test_options_that_have_no_effect_are_refused(words: list[str], message: str, tmp_path: Path) -> None:
    humid_campaign(tmp_path / "runs")
    words = [str(tmp_path / "runs" / "monday") if word == "runs" else word for word in words]
    done = rig("plan", CONFIGS / "basement.toml", *words)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())
