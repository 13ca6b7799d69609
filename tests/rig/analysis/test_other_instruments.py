"""Other pendulums from frames to results.json, and messages about missing data."""

import json
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from typer.testing import CliRunner

from processing.errors import ConfigurationError
from processing.instruments import ValueWithSharedErrors
from processing.instruments.descriptions import INSTRUMENTS
from processing.swing import TurningPoints
from rig.analysis import AnalysedRun, read_results
from rig.analysis.other_instruments import Reduction, _friction_law
from rig.analysis.series import instrument_series
from rig.cli import app
from rig.commands.table_fits import TableOptions, fit_several
from rig.intake import TableColumns
from rig.measure import measure_session
from rig.settings import InstrumentSettings, load_configuration
from rig.terminal import with_uncertainty
from tests.rig.command_line import CONFIGS, figures_are_drawn

FAST_DECAY = ["simulation.contact.b=0.04", "view.mode=none"]
"""A soft coating: 17 half-cycles from 6 to 3 degrees."""


def measure(name: str, folder: Path, *overrides: str, figures: bool = False) -> tuple[int, dict[str, Any]]:
    source = CONFIGS / "instruments" / f"{name}.toml"
    with figures_are_drawn(figures):
        status = measure_session(load_configuration(source, overrides), source, folder)
    return status, json.loads((folder / "results.json").read_text())


def test_every_kind_is_listed_with_a_sentence() -> None:
    shown = CliRunner().invoke(app, ["init", "--instruments"])
    assert shown.exit_code == 0
    lines = shown.output.splitlines()
    assert [line.split()[0] for line in lines] == list(INSTRUMENTS)
    assert all(line.endswith(".") for line in lines)


@pytest.mark.slow
def test_koenig_from_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Damping of |phi| friction b: a half-swing takes about b off ln A, ln 2/b in all."""
    status, results = measure("koenig", tmp_path / "koenig", *FAST_DECAY, figures=True)
    assert status == 0
    run = results["runs"][0]
    found = {row["quantity"]: row for row in run["table"]}
    swings = found["damping_swings"]
    # 1 - cos A in the place of A^2/2 and the map's own steps change it by less than 0.2 %
    assert swings["value"] == pytest.approx(0.5 * math.log(2) / 0.04, rel=2e-3)
    assert found["damping_time_s"]["value"] / swings["value"] == pytest.approx(1.4, rel=2e-3)
    assert [item["verdict"] for item in run["instrument"]["checks"]] == ["within", "within"]
    series = results["series"]["instrument"]
    assert series["ratio"]["value"] == pytest.approx(found["damping_time_s"]["value"] / 250.0)
    said = capsys.readouterr().out
    assert "damping time, mean of 1 place" in said
    assert "half-cycles, 5.99" in said
    assert " deg, " in said
    check_report_of_a_damping(tmp_path / "koenig", found)


def check_report_of_a_damping(folder: Path, found: dict[str, Any]) -> None:
    """The result stands first, in its units; circumstances, a table and a figure of its own, nothing raw."""
    page = (folder / "report.html").read_text()
    first = page.partition('<div class="key">')[2].partition("</div></div>")[0]
    assert "ratio of damping times, sample to reference" in first
    damping = found["damping_time_s"]
    shown = with_uncertainty(damping["value"], damping["u"])
    assert f"damping time, 6° to 3° / s</span><b>{shown}</b>" in first
    for stated in ("UTC, lasted 0.", "<td>operator</td>", "humidity 48", "the simulated rig"):
        assert stated in page
    assert "<td>temperature</td><td>23.4</td><td>°C</td><td>21 to 25 wanted: within</td>" in page
    assert "Fig. " not in page
    assert (folder / "report" / "run-1" / "kind-damping.svg").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("no_fits_meanwhile")
def test_two_balls_from_frames(tmp_path: Path) -> None:
    """The full model with half the load on each ball; truth within four standard uncertainties."""
    truth = {"b": 0.08, "c": 2e-6}
    words = ["session.final_amplitude_arcsec=15.0", "simulation.sensor.width_px=160"]
    words += [f"simulation.contact.{name}={value}" for name, value in truth.items()]
    status, results = measure("two_ball", tmp_path, *words, "camera.frame_rate_hz=50", "view.mode=none")
    assert status == 0
    run = results["runs"][0]
    assert run["pendulum"]["mass_kg"] == pytest.approx(0.6)
    (angle,) = [row for row in run["table"] if row["quantity"] == "contact_angle_rad"]
    assert 46 < angle["value"] * 10800 / math.pi < 47.5
    for name, value in truth.items():
        found = run["fits"]["exact"][name]
        assert abs(found["value"] - value) < 4 * found["standard_uncertainty"], name
    assert "instrument" not in run


@pytest.mark.slow
def test_report_of_a_turning_plane(tmp_path: Path) -> None:
    """The truth's 2 mrad/s within four uncertainties, and the figures that go with it."""
    folder = tmp_path / "one"
    status, results = measure("kuznetsov_one", folder, "simulation.contact.b=0.03", figures=True)
    assert status == 0
    (rate,) = [row for row in results["runs"][0]["table"] if row["quantity"] == "plane_rate_deg_per_min"]
    expected = math.degrees(2e-3) * 60
    assert abs(rate["value"] - expected) < 4 * rate["u"]
    assert (folder / "report" / "run-1" / "kind-plane.svg").exists()
    assert (folder / "report" / "run-1" / "kind-decrement.svg").exists()
    assert "<td>turning of the swing plane</td>" in (folder / "report.html").read_text()


def decaying(
    tau_s: float,
    *,
    turning_rad_per_s: float = 0.0,
    name: str = "",
    envelope: Callable[[Any], Any] | None = None,
    seed: int = 0,
) -> list[str]:
    """Rows of a table in deg: from 6.9 degrees down to 2.6; the time from 6 to 3 is ln 2 times `tau_s`."""
    time_s = np.arange(0.0, tau_s * math.log(6.9 / 2.6), 0.02)
    rng = np.random.default_rng([round(10 * tau_s), seed])
    falling = 6.9 * np.exp(-time_s / tau_s) if envelope is None else envelope(time_s)
    swing = falling * np.cos(2.0 * math.pi * time_s / 1.4)
    columns = [swing]
    if turning_rad_per_s:
        angle = 0.3 + turning_rad_per_s * time_s
        columns = [swing * np.sin(angle), swing * np.cos(angle)]
    seen = (column + 1e-3 * rng.standard_normal(len(swing)) for column in columns)
    rows = np.column_stack([time_s, *seen])
    return [",".join([*filter(None, [name]), *(f"{value:.6f}" for value in row)]) for row in rows]


def fitted(folder: Path, table: str, config: str, *positions: str, status: int = 0) -> Any:
    """results.json of a table."""
    (folder / "table.csv").write_text(table)
    (folder / "kind.toml").write_text(f"[instrument]\n{config}\n")
    path, columns = folder / "table.csv", TableColumns(positions=positions)
    inputs = [(run.run, path, lambda run=run: run) for run in columns.read_runs(path)]
    assert fit_several(inputs, folder / "out", TableOptions(folder / "kind.toml")) == status
    return json.loads((folder / "out" / "results.json").read_text())


def table_of_places(names: Sequence[str], times_s: Sequence[float] = (90.0, 40.0, 42.0)) -> str:
    rows = [row for name, tau_s in zip(names, times_s, strict=True) for row in decaying(tau_s, name=name)]
    return "\n".join(["run,time_s,phi_deg", *rows])


@pytest.mark.parametrize("hold_s", [2.0, 5.0])
def test_the_time_of_the_release_is_told_from_the_first_swing(tmp_path: Path, hold_s: float) -> None:
    """It was told from the first sample of the decay, which is not that of the table: 1.34 s for 2 s."""
    time_s = np.arange(0.0, hold_s + 40.0, 0.02)
    since_s = np.maximum(time_s - hold_s, 0.0)
    damping, rate = 0.04, 2.0 * math.pi / 3.0
    swing = np.exp(-damping * since_s) * (np.cos(rate * since_s) + damping / rate * np.sin(rate * since_s))
    angle = 6.0 * swing + 1e-3 * np.random.default_rng(1).standard_normal(len(time_s))
    rows = "\n".join(f"{time:.3f},{value:.6f}" for time, value in zip(time_s, angle, strict=True))
    found = fitted(tmp_path, "time_s,phi_deg\n" + rows, 'kind = "herbert"')
    (line,) = (text for text in found["runs"][0]["instrument"]["text"] if text.startswith("released"))
    told = re.fullmatch(
        r"released at (\S+) ± \S+ degrees, (\S+) ± (\S+) s before the next turning point", line
    )
    assert told is not None, line
    assert float(told[1]) == pytest.approx(6.0, abs=2e-3)
    assert abs(float(told[2]) - 1.5) < 4 * float(told[3]) < 0.01


@pytest.mark.parametrize(
    ("names", "stated", "period"),
    [
        (("4", "7", "9"), "reference_runs = [4]", "within"),
        (("glass", "a", "b"), "reference_runs = [1]\nperiod_s = 1.5", "outside"),
    ],
)
def test_places_in_one_table_against_its_glass(
    tmp_path: Path, names: Sequence[str], stated: str, period: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each run of a table had its damping time, and nothing was said of mean, ratio and acceptance."""
    found = fitted(tmp_path, table_of_places(names), f'kind = "koenig"\n{stated}')
    series = found["series"]["instrument"]
    assert series["ratio"]["value"] == pytest.approx(41.0 / 90.0, abs=5 * 2e-4)
    assert series["ratio"]["standard_uncertainty"] == pytest.approx(1.0 / 90.0, rel=0.05)
    assert series["ratio_of_swings"]["value"] == pytest.approx(41.0 / 90.0, rel=5e-3)
    assert series["time_s"]["places"] == 2
    assert series["time_s"]["value"] == pytest.approx(41.0 * math.log(2), rel=1e-3)
    # this plate damps four times too fast; constants outside the standard are used
    verdicts = {item["name"]: item["verdict"] for item in series["acceptance"]}
    assert verdicts == {"period on glass": period, "damping time on glass": "outside"}
    said = capsys.readouterr().out
    assert re.search("ratio of damping times, sample to reference +0.45", said)
    assert "240 to 260 wanted: outside" in said
    assert len(read_results(tmp_path / "out").runs) == 3


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ("start_amplitude_deg = 9.0", "below the 9 degrees wanted"),
        ("end_amplitude_deg = 1.0", "never reaches 1 degrees"),
    ],
)
def test_amplitudes_that_are_not_reached(tmp_path: Path, stated: str, words: str) -> None:
    """One line, and with it what there is: range and mean period."""
    table = "\n".join(["time_s,phi_deg", *decaying(40.0)])
    (run,) = fitted(tmp_path, table, f'kind = "koenig"\n{stated}')["runs"]
    assert words in run["problem"]
    assert "\n" not in run["problem"]
    periods_s = {row["fit"]: row["value"] for row in run["table"] if row["quantity"] == "mean_period_s"}
    assert len(periods_s) == 2, "of the decay, and what this kind reports"
    assert [*periods_s.values()] == pytest.approx([1.4] * 2, rel=5e-3)


def test_the_scale_that_places_share_is_in_their_mean_and_not_in_their_ratio(tmp_path: Path) -> None:
    """Constant friction: times go with the scale, known to 1 %. The mean of n places had 1 % over sqrt(n)."""
    rows = [
        f"{run},{row}"
        for run in (1, 2, 3)
        for row in decaying(60.0, envelope=lambda time_s: 6.9 - 0.07 * time_s, seed=run)
    ]
    lever = "[lever]\narm_m = 1.0\nu_arm_m = 0.01\npixel_pitch_m = 5e-6"
    levels = "start_amplitude_deg = 6\nend_amplitude_deg = 3"
    config = f'kind = "kuznetsov_two"\nreference_runs = [1]\n{levels}\n{lever}'
    series = fitted(tmp_path, "\n".join(["run,time_s,phi_deg", *rows]), config)["series"]["instrument"]
    assert series["time_s"]["standard_uncertainty"] == pytest.approx(0.01 * 3 / 0.07, rel=0.05)
    assert series["time_s"]["u_shared"] == pytest.approx(0.01 * 3 / 0.07, rel=0.05)
    assert series["ratio"]["value"] == pytest.approx(1.0, abs=5e-3)
    assert series["ratio"]["standard_uncertainty"] < 1e-3


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ("reference_runs = [7]\nreference_time_s = 250", "there is no run 7, only 1, 2, 3"),
        ("reference_runs = [1]\nstart_amplitude_deg = 8.0", "run 1 has no damping time"),
        ("", "no reference was measured"),
    ],
)
def test_a_ratio_that_cannot_be_had_is_said(
    tmp_path: Path, stated: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    table = table_of_places(("1", "2", "3"), (20.0, 12.0, 13.0))
    found = fitted(tmp_path, table, f'kind = "koenig"\n{stated}')
    assert "ratio" not in found["series"]["instrument"]
    assert words in found["series"]["instrument"]["problem"]
    assert words in " ".join(capsys.readouterr().out.split())


def test_a_run_without_results_of_its_kind_keeps_its_number() -> None:
    """It was not counted, so that `reference_runs = [3]` named no run of three."""
    settings = InstrumentSettings(kind="koenig", reference_runs=(3,))
    sample, glass = Reduction(settings, "sample", ()), Reduction(settings, "glass", ())
    for reduction, time_s in ((sample, 41.0), (glass, 90.0)):
        reduction.readings = dict.fromkeys(
            ("time_s", "swings", "period_s"), ValueWithSharedErrors(time_s, 1.0)
        )
    runs = [AnalysedRun(path=Path(), record="", reduction=item) for item in (sample, None, glass)]
    series = instrument_series(runs)
    assert series is not None
    assert series.instrument is not None
    assert series.instrument.problem is None
    assert series.instrument.ratio is not None
    assert series.instrument.ratio.value == pytest.approx(41.0 / 90.0)


def test_a_reference_measured_elsewhere_and_a_clock_that_is_wrong(tmp_path: Path) -> None:
    """The clock's rate was left out, and its u of every time; the reference has another clock."""
    table = "\n".join(["time_s,phi_deg", *decaying(110.0)])
    clock = "[timebase]\ncamera_rate = 1.01\nu_camera_rate = 2e-3"
    config = f'kind = "koenig"\nreference_time_s = 250\nu_reference_time_s = 0.5\n{clock}'
    found = fitted(tmp_path, table, config)
    true_s = 1.01 * 110.0 * math.log(2)
    rows = {row["quantity"]: row for row in found["runs"][0]["table"]}
    value, u = rows["damping_time_s"]["value"], rows["damping_time_s"]["u"]
    assert value == pytest.approx(true_s, rel=1e-3)
    assert u == pytest.approx(2e-3 * true_s, rel=0.05)
    ratio = found["series"]["instrument"]["ratio"]
    assert ratio["value"] == pytest.approx(true_s / 250.0, rel=1e-3)
    assert ratio["standard_uncertainty"] == pytest.approx(math.hypot(2e-3, 2e-3) * true_s / 250.0, rel=0.05)


@pytest.mark.parametrize(
    ("kind", "rate_rad_per_s"), [("kuznetsov_one", 2e-3), ("kuznetsov_one", -2e-3), ("koenig", -4e-3)]
)
def test_a_plane_that_turns_in_a_table_of_two_axes(tmp_path: Path, kind: str, rate_rad_per_s: float) -> None:
    """Times along the direction of all positions were up to nine uncertainties too short."""
    table = "\n".join(["time_s,x_deg,y_deg", *decaying(60.0, turning_rad_per_s=rate_rad_per_s)])
    config = f'kind = "{kind}"\nstart_amplitude_deg = 6.0\nend_amplitude_deg = 3.0\nreference_time_s = 40'
    found = fitted(tmp_path, table, config, "x_deg", "y_deg")
    rows = {row["quantity"]: row for row in found["runs"][0]["table"]}
    value, u = rows["damping_time_s"]["value"], rows["damping_time_s"]["u"]
    assert abs(value - 60.0 * math.log(2)) < 4 * u < 0.1
    rate = rows["plane_rate_deg_per_min"]
    # from the second position towards the first
    assert abs(rate["value"] - math.degrees(60 * rate_rad_per_s)) < 4 * rate["u"]


@pytest.mark.parametrize(
    ("override", "words"),
    [("end_amplitude_deg=7.0", "must be below"), ("reference_runs=[0]", "runs count from 1")],
)
def test_wrong_settings_are_said(override: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        load_configuration(CONFIGS / "instruments" / "koenig.toml", [f"instrument.{override}"])


@pytest.mark.parametrize(("first", "last", "windows"), [(7, 37, 15), (46, 205, 26)])
def test_the_decrement_is_averaged_over_a_fortieth_of_the_half_cycles(
    first: int, last: int, windows: int
) -> None:
    index = np.arange(first, last + 1, dtype=np.int64)
    same = np.full(len(index), 1e-5)
    points = TurningPoints(index, 2.0 * index, same, 0.1 * np.exp(-0.01 * index), same)
    report = MagicMock(points=points, curves={})
    _friction_law(MagicMock(reference_rad=0.05), MagicMock(), report)
    # 159 half-cycles make windows of three cycles, 30 of one; a cycle has two half-cycles of 0.01
    losses = report.curves["decrement"]["log_decrement"]
    assert losses == pytest.approx(np.full(windows, 0.02))
