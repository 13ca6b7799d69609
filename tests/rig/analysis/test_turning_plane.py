"""A pendulum that turns about the vertical: the fit follows its plane of swing, or withholds."""

import json
import re
from dataclasses import replace
from functools import cache
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from calibration import Axes
from processing.balance import BalanceEstimator, balance_of_run
from processing.deflections import Deflections, DeflectionUnit
from rig.analysis import AnalysedRun, follow_plane, session_results
from rig.analysis.results import RunResults
from rig.analysis.turning_plane import balances_for_plane
from rig.instrument import balance_failures, balance_verdicts
from tests.rig.analysis.spinning import (
    DEG_PER_MIN,
    DEMONSTRATION,
    Spin,
    analysed,
    analysed_table,
    configuration,
    passed,
    positions,
)
from tests.rig.command_line import SMALL, rig, set_words

FAST = 5e-4  # rad/s, 1.72 deg/min
FIRST_ARCSEC = 123.236  # the first amplitude of all runs here
PLANE = "plane_of_swing_rad"
TRUE = {"b": 37.33e-4, "c": 10.51e-9, "surface_energy_table2_j_per_m2": 28.896e-3}
BACK = Spin(-0.003, lasts_s=90.0)
DISTURBED = {"leakage": 0.03, "fast_arcsec": 6.0, "rest_arcsec": (-30.0, 15.0)}


def seen_of(spin: Spin, seed: int) -> Deflections:
    """Six minutes of a pendulum that turns so; ten where it is judged how little a rotation may matter."""
    if abs(spin.rate_rad_per_s) < FAST / 10:
        return positions(spin, seed)
    return positions(spin, seed, duration_s=360.0, noise_arcsec=0.001)


@cache
def run_of(spin: Spin, seed: int = 3) -> AnalysedRun:
    """Analysed once."""
    with TemporaryDirectory() as folder:
        return analysed(seen_of(spin, seed), configuration(), Path(folder) / f"run-{seed}.mcap")


def pulls(run: RunResults) -> dict[str, float]:
    """Errors of b, c and the surface energy in standard uncertainties."""
    return {
        name: abs(run.budget[name].value - true) / run.budget[name].standard_uncertainty
        for name, true in TRUE.items()
    }


@pytest.mark.parametrize("spin", [Spin(FAST, **DISTURBED), BACK], ids=["disturbed", "back, coming to rest"])
def test_a_decay_whose_plane_turns_is_followed(spin: Spin) -> None:
    run = run_of(spin)
    assert max(pulls(run).values()) < 3
    assert run.half_cycles > 166
    (said,) = [note for note in run.notes if "plane of swing" in note]
    sign = "−" if spin.rate_rad_per_s < 0 else "+"
    assert re.search(rf"turned by {re.escape(sign)}\d+\.\d+ ± 0\.000\d+ degrees during the run .* back", said)
    assert PLANE in {line.source for line in run.budget["b"].sources}


def judge_series(runs: list[AnalysedRun], power: int, folder: Path) -> None:
    """A series' line for the plane: the mean lowers own errors (power 2), not common ones (1)."""
    series = session_results(runs, folder).series
    assert series is not None
    for name in ("b", "c"):
        of_runs = [
            sum(one.contribution for one in run.budget[name].sources if one.source == PLANE) for run in runs
        ]
        (line,) = [one for one in series.budget[name].sources if one.source == PLANE]
        expected = sum(one**power for one in of_runs) ** (1 / power) / len(runs)
        assert line.contribution == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_the_mean_of_a_series_has_a_line_for_the_plane(tmp_path: Path) -> None:
    """Also with a run that does not turn."""
    judge_series([run_of(Spin(), 5), run_of(Spin(FAST, **DISTURBED)), run_of(BACK)], 2, tmp_path)


@pytest.mark.slow
def test_an_angle_between_the_axes_that_is_not_known_is_a_line_of_the_budget(tmp_path: Path) -> None:
    config, seen = configuration("axes.u_non_orthogonality_rad=2e-3"), seen_of(Spin(FAST), 3)
    # the true axes of the second are as much askew as is stated
    runs = [
        analysed(one, config, tmp_path / f"run-{number}.mcap")
        for number, one in enumerate((seen, replace(seen, y=seen.y + 2e-3 * seen.x)), 1)
    ]
    (line,) = [one for one in runs[0].budget["c"].sources if one.source == PLANE]
    assert line.u_source == pytest.approx(2e-3, rel=1e-3)
    assert line.share > 0.05
    moved = abs(runs[1].budget["c"].value - runs[0].budget["c"].value)
    assert moved == pytest.approx(line.contribution, rel=0.2)
    judge_series(runs, 1, tmp_path)


def test_without_a_rotation_nothing_is_turned_and_there_is_no_step_where_one_begins_to_matter() -> None:
    run = run_of(Spin(), 5)
    assert max(pulls(run).values()) < 3
    assert not any("plane" in note for note in run.notes)
    assert PLANE not in {line.source for line in run.budget["b"].sources}
    still, found = run.budget, run_of(Spin(0.1 * DEG_PER_MIN), 5).budget
    for name in ("b", "p", "c", "n", "period0_s", "gamma_pa"):
        # noise along one axis becomes noise along another
        assert abs(found[name].value - still[name].value) < 0.1 * still[name].standard_uncertainty
        assert found[name].standard_uncertainty == pytest.approx(still[name].standard_uncertainty, rel=0.05)


def test_what_cannot_be_followed_is_withheld(tmp_path: Path) -> None:
    seen = positions(Spin(FAST), seed=3, duration_s=200.0)
    lost = (seen.times_s > 80.0) & (seen.times_s < 120.0)
    seen = replace(seen, x=np.where(lost, np.nan, seen.x))
    run = analysed(seen, configuration(), tmp_path / "run-1.mcap")
    assert run.problem.startswith("withheld: the plane of swing turns")
    assert "is not known in" in run.problem
    assert not run.fits
    assert not run.budget


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spin", "largest_u_b"),
    [
        # angles that are an eighth too large contradict the law, which widens u
        (Spin(-FAST, leakage=0.5), inf),
        (Spin(FAST, leakage=0.03, fast_arcsec=6.0), 1.5e-5),
    ],
)
def test_a_table_of_two_positions_is_fitted_in_both(spin: Spin, largest_u_b: float, tmp_path: Path) -> None:
    """Of `x`, `y` both are taken without being named, and amplitudes are those along the swing."""
    config = configuration().model_copy(update={"lever": None, "axes": None})
    run = analysed_table(seen_of(spin, 4), config, tmp_path / "both.csv")
    scale = np.hypot(1.0, spin.leakage)
    assert run.amplitudes[0] == pytest.approx(FIRST_ARCSEC * scale, rel=3e-4)
    b, c = run.budget["b"], run.budget["c"]
    assert abs(c.value - 10.51e-9 * scale) < 3 * c.standard_uncertainty
    assert abs(b.value - 37.33e-4 * scale**0.056) < 3 * b.standard_uncertainty
    # the fast mode is no noise of the samples, though no axis of the table is at a right angle to it
    assert b.standard_uncertainty < largest_u_b
    assert not any("direction" in warning for warning in run.warnings)


def test_a_table_of_two_positions_needs_no_configuration(tmp_path: Path) -> None:
    seen = positions(Spin(-FAST, leakage=0.5), seed=4, duration_s=100.0)
    run = analysed_table(seen, None, tmp_path / "both.csv")
    assert run.amplitudes[0] == pytest.approx(FIRST_ARCSEC * np.hypot(1.0, 0.5), rel=3e-4)


@pytest.mark.parametrize(
    ("spin", "fails"),
    [
        (Spin(), set()),
        (Spin(FAST), {"plane of swing"}),
        (Spin(0.1 * DEG_PER_MIN), set()),
        (Spin(0.003, lasts_s=60.0), {"plane of swing"}),
        (Spin(fast_arcsec=6.0), {"transverse motion"}),
        (Spin(rest_arcsec=(-30.0, 15.0)), {"tilt at rest, X", "tilt at rest, Y"}),
    ],
)
def test_the_balance_is_a_condition(spin: Spin, fails: set[str]) -> None:
    config = configuration()
    followed = follow_plane(*passed(positions(spin, seed=3, duration_s=200.0)), config.axes)
    balance = balance_of_run(followed.balances, followed.plane)
    verdicts = balance_verdicts(balance, config.balance)
    assert {one.name for one in verdicts if not one.ok} == fails
    assert len(verdicts) == 5
    for one in verdicts:
        assert one.measured
        assert one.limit
        assert one.ok == (not one.remedy)
    if "plane of swing" in fails and spin.lasts_s == inf:
        (turning,) = [one for one in verdicts if one.name == "plane of swing"]
        assert turning.measured.endswith("deg/min")
        assert turning.limit == "0.2 deg/min"
        assert "rig balance" in turning.remedy
    assert balance is not None
    assert len(balance_failures(balance, config.balance)) == len(fails)
    in_px = balance_verdicts(replace(balance, unit=DeflectionUnit.PX), config.balance)
    assert [one.name for one in in_px] == ["transverse motion", "ellipticity", "plane of swing"]
    # a run without a decay has no balance
    assert balance_of_run([], None) is None
    assert balance_verdicts(None, config.balance) == []


@pytest.mark.slow
@pytest.mark.usefixtures("no_fits_meanwhile")
def test_a_session_whose_pendulum_turns_is_fitted_and_does_not_meet_its_conditions(tmp_path: Path) -> None:
    """From frames on."""
    words = SMALL | {
        "simulation.sensor.width_px": "320",
        "session.max_duration_s": "600",
        "camera.frame_rate_hz": "8",
        "record.windows": "false",
        "simulation.axes.spin_rad_per_s": str(-FAST),
    }
    done = rig("run", DEMONSTRATION, "-o", tmp_path / "out", *set_words(words))
    assert done.returncode == 1
    assert "PLANE OF SWING: " in done.stdout
    (run,) = json.loads((tmp_path / "out" / "results.json").read_text())["runs"]
    failed = [one for one in run["conditions"] if not one["ok"]]
    assert [one["name"] for one in failed] == ["plane of swing"]
    assert failed[0]["limit"] == "0.2 deg/min"
    for name, true in TRUE.items():
        item = run["budget"][name]
        assert abs(item["value"] - true) < 3 * item["standard_uncertainty"]
        assert item["standard_uncertainty"] < 0.01 * true
    assert any("turned back" in note for note in run["notes"])


def test_the_balances_of_a_run_give_its_plane() -> None:
    # as in a run: all samples, along its axes, block by block
    seen = positions(Spin(FAST), seed=3, duration_s=200.0)
    half_cycles, passing = passed(seen)
    estimator = BalanceEstimator()
    recorded = [balance for block in passing for balance in estimator.update(block)]
    taken = balances_for_plane(recorded, half_cycles, Axes())
    assert taken == [
        b for b in recorded if half_cycles[0].turn_time_ns <= b.time_ns <= half_cycles[-1].turn_time_ns
    ]
    by_recorded = follow_plane(half_cycles, passing, Axes(), balances=taken)
    by_deflections = follow_plane(half_cycles, passing, Axes())
    assert by_recorded.is_turned
    assert by_recorded.plane is not None
    assert by_deflections.plane is not None
    difference = by_recorded.plane.mean_rate() - by_deflections.plane.mean_rate()
    assert abs(difference) < 3.0 * by_deflections.plane.u_mean_rate()
    # an estimate that failed in the middle of the run, and axes along which no line has its true angle
    assert balances_for_plane(recorded[: len(recorded) // 2], half_cycles, Axes()) is None
    assert balances_for_plane([], half_cycles, Axes()) is None
    assert balances_for_plane(recorded, half_cycles, Axes(non_orthogonality_rad=0.01)) is None
