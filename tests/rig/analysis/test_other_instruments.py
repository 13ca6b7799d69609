"""Other pendulums from frames to results.json, and messages about missing data."""

import json
import math
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from processing.errors import ConfigurationError
from processing.instruments.descriptions import INSTRUMENTS
from rig.cli import app
from rig.commands.fitting import fit_records
from rig.measure.session import measure_session, simulate_record
from rig.presentation import with_uncertainty
from rig.settings import load_configuration
from tests.rig.command_line import figures_are_not_drawn

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
FAST_DECAY = ["simulation.contact.b=0.04", "view.mode=none", "view.file=false"]
"""A soft coating: 17 half-cycles from 6 to 3 degrees."""


def measure(name: str, folder: Path, *overrides: str, figures: bool = False) -> tuple[int, dict[str, Any]]:
    source = CONFIGS / "instruments" / f"{name}.toml"
    with nullcontext() if figures else figures_are_not_drawn():
        status = measure_session(load_configuration(source, overrides), source, folder)
    return status, json.loads((folder / "results.json").read_text())


def simulate(name: str, record: Path, *overrides: str) -> Path:
    source = CONFIGS / "instruments" / f"{name}.toml"
    assert simulate_record(load_configuration(source, overrides), source, record) == 0
    return record


def test_every_kind_is_listed_with_a_sentence() -> None:
    shown = CliRunner().invoke(app, ["instruments"])
    assert shown.exit_code == 0
    lines = shown.output.splitlines()
    assert [line.split()[0] for line in lines] == list(INSTRUMENTS)
    assert all(line.endswith(".") for line in lines)


@pytest.mark.slow
def test_koenig_from_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Damping of |phi| friction b: a half-swing takes about b off ln A, ln 2/b in all."""
    status, results = measure("koenig", tmp_path / "koenig", *FAST_DECAY, figures=True)
    assert status == 0
    found = results["runs"][0]["instrument"]
    swings = found["damping"]["swings"]
    # 1 - cos A in the place of A^2/2 and the map's own steps change it by less than 0.2 %
    assert swings["value"] == pytest.approx(0.5 * math.log(2) / 0.04, rel=2e-3)
    assert found["damping"]["time_s"]["value"] / swings["value"] == pytest.approx(1.4, rel=2e-3)
    assert [item["verdict"] for item in found["environment"]] == ["within", "within"]
    series = results["series"]["instrument"]
    assert series["ratio"]["value"] == pytest.approx(found["damping"]["time_s"]["value"] / 250.0)
    said = capsys.readouterr().out
    assert "damping time over 1 place: " in said
    assert "half-cycles, 5.99" in said
    assert " deg, " in said
    check_report_of_a_damping(tmp_path / "koenig", found)


def check_report_of_a_damping(folder: Path, found: dict[str, Any]) -> None:
    """The result stands first, in its units; circumstances, a table and a figure of its own, nothing raw."""
    page = (folder / "report.html").read_text()
    first = page.partition('<div class="key">')[2].partition("</div></div>")[0]
    assert "ratio of damping times, sample to reference" in first
    damping = found["damping"]["time_s"]
    shown = with_uncertainty(damping["value"], damping["standard_uncertainty"])
    assert f"damping time, 6° to 3° / s</span><b>{shown}</b>" in first
    for stated in ("UTC, lasted 0.", "<td>operator</td>", "humidity 48", "the simulated rig"):
        assert stated in page
    assert "<td>temperature</td><td>23.4</td><td>°C</td><td>21 to 25 wanted: within</td>" in page
    assert "Fig. " not in page
    assert (folder / "report" / "run-1" / "kind-damping.svg").exists()
    table = (folder / "report" / "run-1" / "instrument.csv").read_text()
    assert f"damping.time_s,{damping['value']}" in table
    assert "text" not in table


@pytest.mark.slow
def test_koenig_series_with_its_glass_plate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two places and the glass in one series: ratio, spread, acceptance with a verdict."""
    glass = simulate("koenig", tmp_path / "glass.mcap", "simulation.contact.b=0.02", "view.file=false")
    places = [
        simulate("koenig", tmp_path / f"place-{b}.mcap", f"simulation.contact.b={b}", "view.file=false")
        for b in (0.04, 0.05)
    ]
    assert fit_records([glass, *places], tmp_path / "fit", ["instrument.reference_runs=[1]"]) == 0
    series = json.loads((tmp_path / "fit" / "results.json").read_text())["series"]["instrument"]
    assert series["time_s"]["places"] == 2
    expected = 0.5 * (0.02 / 0.04 + 0.02 / 0.05)
    assert series["ratio"]["value"] == pytest.approx(expected, rel=5e-3)
    assert series["ratio_of_swings"]["value"] == pytest.approx(expected, rel=5e-3)
    verdicts = {item["name"]: item["verdict"] for item in series["acceptance"]}
    # this plate damps ten times too fast; the period is right
    assert verdicts == {"period on glass": "within", "damping time on glass": "outside"}
    assert "250 ± 10 s wanted: outside" in capsys.readouterr().out


@pytest.mark.slow
def test_two_balls_from_frames(tmp_path: Path) -> None:
    """The full model with half the load on each ball; truth within four standard uncertainties."""
    truth = {"b": 0.08, "c": 2e-6}
    status, results = measure(
        "two_ball",
        tmp_path / "two",
        *(f"simulation.contact.{name}={value}" for name, value in truth.items()),
        "session.final_amplitude_arcsec=4.0",
        "view.mode=none",
        "view.file=false",
    )
    assert status == 0
    run = results["runs"][0]
    assert run["pendulum"]["mass_kg"] == pytest.approx(0.6)
    angle_arcmin = run["hertz"]["angle_rad"]["value"] * 10800 / math.pi
    assert 46 < angle_arcmin < 47.5
    for name, value in truth.items():
        found = run["fits"]["exact"][name]
        assert abs(found["value"] - value) < 4 * found["standard_uncertainty"], name
    assert "instrument" not in run


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["instrument.start_amplitude_deg=9.0"], "below the 9 degrees wanted"),
        (["session.max_duration_s=8.0"], "never reaches 3 degrees"),
    ],
)
def test_amplitudes_that_are_not_reached(tmp_path: Path, overrides: list[str], words: str) -> None:
    """One line, and with it what there is: range and mean period."""
    status, results = measure("koenig", tmp_path / "k", *FAST_DECAY, *overrides)
    assert status == 1
    run = results["runs"][0]
    assert words in run["problem"]
    assert "\n" not in run["problem"]
    assert run["instrument"]["mean_period_s"] == pytest.approx(1.4, rel=5e-3)


@pytest.mark.slow
def test_report_of_a_turning_plane(tmp_path: Path) -> None:
    """The truth's 2 mrad/s within four uncertainties, and the figures that go with it."""
    folder = tmp_path / "one"
    status, results = measure(
        "kuznetsov_one", folder, "simulation.contact.b=0.03", "view.file=false", figures=True
    )
    assert status == 0
    rate = results["runs"][0]["instrument"]["swing_plane"]["rate_deg_per_min"]
    expected = math.degrees(2e-3) * 60
    assert abs(rate["value"] - expected) < 4 * rate["standard_uncertainty"]
    assert (folder / "report" / "run-1" / "kind-plane.svg").exists()
    assert (folder / "report" / "run-1" / "kind-decrement.svg").exists()
    assert "the swing plane turns" in (folder / "report.html").read_text()


def test_no_glass_is_said(tmp_path: Path) -> None:
    text = (CONFIGS / "instruments" / "koenig.toml").read_text()
    own = tmp_path / "own.toml"
    own.write_text("\n".join(line for line in text.splitlines() if "reference_time_s" not in line))
    assert simulate_record(load_configuration(own, FAST_DECAY), own, tmp_path / "o.mcap") == 0
    assert fit_records([tmp_path / "o.mcap"], tmp_path / "without", []) == 0
    series = json.loads((tmp_path / "without" / "results.json").read_text())["series"]["instrument"]
    assert "no reference was measured" in series["problem"]
    assert series["time_s"]["value"] > 0


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("instrument.kind=koening", "instrument.kind"),
        ("instrument.end_amplitude_deg=7.0", "must be below"),
        ("instrument.reference_runs=[0]", "runs count from 1"),
        ("instrument.mass=0.2", "did you mean mass_kg"),
    ],
)
def test_wrong_settings_are_one_line(override: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words.replace(".", r"\.")) as error:
        load_configuration(CONFIGS / "instruments" / "koenig.toml", [override])
    assert "\n" not in str(error.value)


def test_constants_outside_the_standard_are_used_and_said(tmp_path: Path) -> None:
    record = simulate(
        "koenig", tmp_path / "p.mcap", *FAST_DECAY, "simulation.contact.period0_s=1.5", "session.runs=1"
    )
    assert fit_records([record], tmp_path / "fit", ["instrument.reference_runs=[1]"]) == 0
    series = json.loads((tmp_path / "fit" / "results.json").read_text())["series"]["instrument"]
    assert series["acceptance"][0]["verdict"] == "outside"


def test_the_demonstration_is_the_single_ball() -> None:
    config = load_configuration(CONFIGS / "demo.toml")
    assert config.instrument.kind == "single_ball"
    assert config.simulation.contact.exact_pendulum is False
