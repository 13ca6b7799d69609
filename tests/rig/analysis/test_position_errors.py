"""Half-cycles once the motion is known: less errors of position, and from few and noisy samples."""

from functools import cache
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from processing.deflections import Deflections, DeflectionUnit, joined, slow_deflections
from processing.fit import (
    FIXED_PATTERN,
    Refinement,
    fit_exact,
    known_motion,
    row_delay,
    second_measurement,
)
from processing.spot import SPOT_DTYPE
from processing.swing import HarmonicsMeasurement, half_cycles_of_blocks, turning_points
from processing.units import ARCSEC_RAD
from rig.analysis import PositionErrors, RunResults, SessionResults, passing_deflections, refined_half_cycles
from rig.analysis.ambient import FREE_DRAG, evidence_of
from rig.analysis.passing_deflections import PassingDeflections, _spots, deflection_change
from rig.analysis.results_file import read_results, write_results
from rig.instrument import optics_of
from rig.report.figures_motion import position_error_figure
from rig.settings import FitSettings, load_configuration
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import World, driven_path
from tests.processing.fit.frames import seen_in_frames
from tests.processing.position_map.runs import Run, fringes, nothing, run
from tests.rig.command_line import CONFIGS


def in_blocks(one: Run) -> list[Deflections]:
    return [one.deflections[start : start + 777] for start in range(0, len(one.deflections), 777)]


@cache
def refined_over_fringes() -> tuple[Run, PassingDeflections, Refinement]:
    """A run over fringes, its deflections, and what is made of them."""
    one = run(fringes, seed=1)
    passing = PassingDeflections(in_blocks(one), DeflectionUnit.RAD)
    refined = refined_half_cycles(one.half_cycles, passing, passing.unit, one.pendulum, FitSettings())
    return one, passing, refined


@pytest.mark.slow
def test_fringes_no_longer_move_the_parameters(tmp_path: Path) -> None:
    one, passing, refined = refined_over_fringes()
    assert refined.position_map is not None
    assert refined.exact is not None
    assert FIXED_PATTERN in refined.exact.terms
    before = fit_exact(turning_points(one.half_cycles), one.pendulum)
    assert refined.exact.estimate("n").standard_uncertainty < 0.5 * before.estimate("n").standard_uncertainty
    for name in refined.exact.contact_names:
        value, u = refined.exact.estimate(name)
        assert abs(value - getattr(one.parameters, name)) < 3 * u, name
    # all passes but the first leave the counts alone
    assert passing.frames == len(one.deflections)
    assert passing.last_ns == one.deflections.times_ns[-1]

    errors = PositionErrors.of(refined.position_map, DeflectionUnit.RAD)
    assert 0.01 < np.std(errors.error) / ARCSEC_RAD < 0.015
    assert "0.012 arcsec r.m.s." in errors.text
    path = tmp_path / "results.json"
    write_results(path, SessionResults(runs=(RunResults(record="one", position_errors=errors),)))
    (again,) = read_results(path).runs
    assert again.position_errors is not None
    assert np.array_equal(again.position_errors.error, errors.error)
    (axes,) = position_error_figure(errors).figure.axes
    assert np.allclose(axes.lines[1].get_ydata(), errors.error / ARCSEC_RAD)


@pytest.mark.slow
def test_without_structure_nothing_changes_bit_for_bit() -> None:
    one = run(nothing, seed=1)
    refined = refined_half_cycles(
        one.half_cycles, in_blocks(one), DeflectionUnit.RAD, one.pendulum, FitSettings()
    )
    waveform = HarmonicsMeasurement(one.half_cycles)
    for block in in_blocks(one):
        waveform.update(block)
    evidence = evidence_of(FREE_DRAG, waveform.harmonics())
    first = fit_exact(turning_points(one.half_cycles), one.pendulum, drag=True, evidence=evidence)
    motion = known_motion(first.parameters, one.pendulum, float(turning_points(one.half_cycles).amplitude[0]))
    again = second_measurement(one.half_cycles, [one.deflections], motion)
    assert refined.position_map is None
    assert repr(list(refined.half_cycles)) == repr(again)
    second = fit_exact(turning_points(again), one.pendulum, drag=True, evidence=evidence, near=first)
    assert refined.exact is not None
    assert np.array_equal(refined.exact.values, second.values)
    assert np.array_equal(refined.exact.covariance, second.covariance)


@pytest.mark.slow
def test_the_waveform_is_that_of_the_deflections_without_the_errors() -> None:
    """They change the third harmonic of friction, too, by which contact and air are told apart."""
    one, _, refined = refined_over_fringes()
    assert refined.position_map is not None
    assert refined.harmonics is not None
    straight, raw = HarmonicsMeasurement(refined.half_cycles), HarmonicsMeasurement(one.half_cycles)
    for block in in_blocks(one):
        straight.update(refined.position_map.corrected(block))
        raw.update(block)
    third = 1
    found, without, with_errors = (
        float(np.mean(each.sine[:, third]))
        for each in (refined.harmonics, straight.harmonics(), raw.harmonics())
    )
    assert abs(found - without) < 0.2 * abs(with_errors - without)


@pytest.mark.slow
def test_few_noisy_samples_are_measured_again() -> None:
    """25 a second with 0.2 arcsec: the detector's shared errors moved n by 5 u, and were kept for that."""
    parameters, pendulum = paper_pair("glass_k8")
    _, _, path = driven_path(parameters, pendulum, q=0.0, seed=1, frames_per_s=25.0)
    noise = 0.2 * ARCSEC_RAD
    times_ns = np.arange(len(path), dtype=np.int64) * 40_000_000
    seen = path + noise * np.random.default_rng([0, 9]).standard_normal(len(path))
    blocks = [slow_deflections(times_ns, seen, noise)]
    half_cycles = half_cycles_of_blocks(blocks)
    refined = refined_half_cycles(half_cycles, blocks, DeflectionUnit.RAD, pendulum, FitSettings())
    assert refined.motion is not None
    assert not refined.doubt
    assert refined.exact is not None
    for name in ("n", "period0_s", "gamma_pa"):
        value, u_value = refined.exact.estimate(name)
        assert abs(value - getattr(parameters, name)) < 3 * u_value, name


@pytest.mark.slow
def test_the_waveform_ends_where_a_knock_moved_the_rest_position() -> None:
    """Beside the middle of the contact the swing has a second harmonic, and the rows' times had the blame."""
    parameters, pendulum = paper_pair("glass_k8")
    at_s, moved = 200.0, 3.0 * ARCSEC_RAD
    rate_rad_per_s = 2 * np.pi / parameters.period0_s
    _, _, path = driven_path(
        parameters,
        pendulum,
        World(event_s=at_s, knock_rad_per_s=5.0 * ARCSEC_RAD * rate_rad_per_s),
        q=1e-9,
        seed=1,
        last_arcsec=50.0,
        frames_per_s=25.0,
        forcing=lambda time_s: np.where(time_s < at_s, 0.0, rate_rad_per_s**2 * moved),
    )
    blocks = [seen_in_frames(path, 0.005 * ARCSEC_RAD, 1)]
    half_cycles = half_cycles_of_blocks(blocks)
    refined = refined_half_cycles(half_cycles, blocks, DeflectionUnit.RAD, pendulum, FitSettings())
    assert "moved the rest position" in refined.doubt
    assert refined.harmonics is not None
    fitted = turning_points(refined.half_cycles)
    assert refined.harmonics.amplitude.min() >= fitted.amplitude.min()
    assert not row_delay(refined.harmonics, parameters.period0_s).seen


@pytest.mark.parametrize(("short", "asked"), [(20, 1), (19, 3)])
def test_every_pass_has_the_same_frames(short: int, asked: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three blocks of ten frames, the second one empty."""
    monkeypatch.setattr(passing_deflections, "_MAX_FRAMES_IN_MEMORY", short)
    every = slow_deflections(np.arange(20, dtype=np.int64), np.zeros(20), 1e-9)
    record = MagicMock()
    record.__iter__.side_effect = lambda: iter([every[:10], every[10:10], every[10:]])
    passing = PassingDeflections(record, DeflectionUnit.RAD)
    for _ in range(3):
        assert joined(passing, passing.unit).times_ns.tolist() == list(range(20))
    assert passing.frames == 20
    assert record.__iter__.call_count == asked


def test_changed_deflections_are_those_of_spots_that_were_there_from_the_start() -> None:
    config = load_configuration(CONFIGS / "demo.toml")
    random = np.random.default_rng(4)
    spots = np.zeros(30, [("time_ns", np.int64), *SPOT_DTYPE.descr])
    spots["time_ns"] = 20_000_000 * np.arange(30)
    spots["x_px"], spots["y_px"] = random.uniform(50, 70, (2, 30))
    spots["u_x_px"], spots["u_y_px"] = 0.02, 0.03
    moved = spots.copy()
    moved["x_px"] += random.normal(0.4, 0.1, 30)
    moved["y_px"] -= random.normal(0.7, 0.1, 30)
    moved["u_x_px"], moved["u_y_px"] = 0.05, 0.07
    of_spots = optics_of(config, full_scale_dn=1.0).deflector((1, 1))
    before, after = (of_spots(table["time_ns"], _spots(table)) for table in (spots, moved))
    # some frames, as a run that is read in blocks gives them
    found = deflection_change(config, spots, moved)(before[7:20])
    for name in ("x", "y", "u_x", "u_y"):
        assert getattr(found, name) == pytest.approx(getattr(after, name)[7:20], rel=1e-9), name
