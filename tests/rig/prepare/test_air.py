"""`rig calibrate air`: runs with vanes, the file that they make, and a fit that uses it."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration import read_calibration
from processing.ambient import AmbientConditions
from processing.errors import ConfigurationError, DataError
from processing.fit import drag_verdict
from processing.fit.vanes import VanedRun
from rig.analysis import AnalysedRun, analyse_record, remarks
from rig.analysis.ambient import drag_at_pressure, expected_drag
from rig.instrument import complete, pendulum_on_ball
from rig.measure import simulate_record
from rig.prepare import Filing, calibrate_air, vanes_to_cut
from rig.settings import validate_configuration

DRAG_S = 1.7e-3
fitted_once = cache(analyse_record)


def configuration(area_m2: float, **sections: Any) -> Any:
    simulation = {
        "max_duration_s": 130.0,
        "seed": round(1 + 1000 * area_m2),
        "contact": {"drag_s": DRAG_S, "vane_area_m2": area_m2},
        "fast": {"amplitude_arcsec": 0.0},
        "ground": {"model": "none"},
        "sensor": {"width_px": 96},
        "clock": {"frame_rate_hz": 25.0},
    }
    record = {"windows": False, "full_frame_interval_s": 1000.0}
    tree = {"camera": {"driver": "simulated"}, "simulation": simulation, "record": record, **sections}
    return validate_configuration(tree, "test")


@pytest.fixture(scope="module")
def vanes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run without vanes, one with, and their list."""
    folder = tmp_path_factory.mktemp("vanes")
    lines = []
    for number, area_m2 in enumerate((0.0, 0.1)):
        record = folder / f"{number}.mcap"
        assert simulate_record(configuration(area_m2), folder / "none.toml", record) == 0
        lines += ["[[run]]", f"record = '{record.name}'", f"area_m2 = {area_m2}"]
    (folder / "vanes.toml").write_text("\n".join(lines))
    return folder / "vanes.toml"


@pytest.mark.slow
def test_the_drag_is_measured_filed_and_used(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.prepare.lever.analyse_record", fitted_once)
    monkeypatch.setattr("rig.analysis.contact_verdicts.drag_verdict", drag_verdict)
    path = calibrate_air(vanes, Filing(tmp_path / "c", 30, "A. Person"))
    found = read_calibration(path, "air")
    drag_s, u_drag_s = found.values["drag_s"], found.values["u_drag_s"]
    assert abs(drag_s - DRAG_S) < 4 * u_drag_s < 0.5 * DRAG_S
    assert found.method == "2 runs, 2 areas of vanes"
    assert [source.name for source in found.sources] == ["vanes.toml", "0.mcap", "1.mcap"]
    (note,) = found.notes
    assert "at three" in note
    assert found.details["expected_drag_s"] == pytest.approx(DRAG_S, rel=0.2)
    stated = configuration(0.0, calibration={"air": str(path)})
    fit = complete(stated).fit
    assert (fit.drag_s, fit.u_drag_s) == (drag_s, u_drag_s)
    assert complete(complete(stated)) == complete(stated), "as a record's configuration is"
    open_fit = complete(configuration(0.0, calibration={"air": str(path)}, fit={"drag": "open"})).fit
    assert open_fit.drag_s is None, "open by name holds"
    other = {"drag_s": 1e-3, "u_drag_s": 1e-5}
    with pytest.raises(ConfigurationError, match="leave one of them out"):
        complete(configuration(0.0, calibration={"air": str(path)}, fit=other))
    measured = [f"fit.drag_s={drag_s}", f"fit.u_drag_s={u_drag_s}"]
    results = analyse_record(vanes.parent / "0.mcap", measured)
    assert results.drag is not None
    assert results.drag.known_s is not None
    assert results.drag.known_s.value == drag_s
    assert results.drag.drag_s.standard_uncertainty < u_drag_s
    assert any("drag" in line for line in remarks(results))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("[[run]]\nrecord = '0.mcap'\narea_m2 = 0.0", "two different areas or pressures"),
        ("[[run]]\nrecord = '0.mcap'", "either area_m2 or pressure_pa"),
        (
            "[[run]]\nrecord = '0.mcap'\narea_m2 = 0.1\n[[run]]\nrecord = '1.mcap'\npressure_pa = 9e4",
            "area_m2 of every",
        ),
        (
            "[[run]]\nrecord = '0.mcap'\narea_m2 = 0.1\n[[run]]\nrecord = 'no.mcap'\narea_m2 = 0",
            "no.mcap: no such record",
        ),
        (
            "[[run]]\nrecord = '0.mcap'\narea_m2 = 0.1\n[[run]]\nrecord = '0.mcap'\narea_m2 = 0",
            "0.mcap: holds the run of",
        ),
    ],
)
def test_what_cannot_serve_is_said_in_one_line(vanes: Path, tmp_path: Path, lines: str, said: str) -> None:
    path = vanes.parent / "wrong.toml"
    path.write_text(lines)
    with pytest.raises(ConfigurationError) as caught:
        calibrate_air(path, Filing(tmp_path / "c"))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "c").exists()


@pytest.mark.slow
def test_areas_that_were_swapped_are_refused(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The drag was that of the pendulum with its vanes, without a word."""
    monkeypatch.setattr("rig.prepare.lever.analyse_record", fitted_once)
    swapped = vanes.parent / "swapped.toml"
    swapped.write_text(
        vanes.read_text().replace("0.mcap", "x").replace("1.mcap", "0.mcap").replace("x", "1.mcap")
    )
    with pytest.raises(DataError, match="of drag per m² of vanes, and vanes add some: see which record"):
        calibrate_air(swapped, Filing(tmp_path / "c"))
    assert not (tmp_path / "c").exists()


@pytest.mark.slow
def test_a_run_that_was_not_measured_twice_is_named(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def second_as_detected(record: Path, *, air_known: bool) -> AnalysedRun:
        run = fitted_once(record, air_known=air_known)
        return replace(run, measured_again_on=None) if record.name == "1.mcap" else run

    for analyse, named in ((fitted_once, False), (second_as_detected, True)):
        monkeypatch.setattr("rig.prepare.lever.analyse_record", analyse)
        notes = read_calibration(calibrate_air(vanes, Filing(tmp_path / f"{named}")), "air").notes
        assert (
            any("turning points of run 2 could not be measured a second time" in one for one in notes)
            == named
        )


@pytest.mark.slow
def test_runs_at_two_pressures_are_compared_by_the_drag_of_the_room(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[VanedRun] = []

    def only_given(runs: list[VanedRun], *_: object, **by: bool) -> None:
        given.extend(runs)
        raise DataError("enough")

    monkeypatch.setattr("rig.prepare.lever.analyse_record", fitted_once)
    monkeypatch.setattr("rig.prepare.lever.air_of_vanes", only_given)
    path = vanes.parent / "pressures.toml"
    runs = ("record = '0.mcap'\npressure_pa = 2.5e4", "record = '1.mcap'\npressure_pa = 1e5")
    path.write_text("".join(f"[[run]]\n{run}\n" for run in runs))
    with pytest.raises(DataError, match="enough"):
        calibrate_air(path, Filing(tmp_path / "c"))
    # of air that moves in layers the drag goes with the root of its density
    assert [run.exposure for run in given] == pytest.approx([0.5, 1.0], rel=0.1)
    # how wide a bar resists as this pendulum is known to a third: of the ratio, that is some per cent
    config = complete(configuration(0.0))
    pendulum = pendulum_on_ball(config)
    assert pendulum is not None
    assumed_m = expected_drag(AmbientConditions(), pendulum, 4.071, config).width_m
    sizes = {"mass_kg": pendulum.mass_kg, "ball_radius_m": pendulum.ball_radius_m}
    ratios = []
    for factor in (0.7, 1.3):
        wide = complete(configuration(0.0, pendulum=sizes | {"width_m": factor * assumed_m}))
        thin, thick = (
            expected_drag(AmbientConditions(pressure_pa=pressure_pa), pendulum, 4.071, wide).drag_s
            for pressure_pa in (2.5e4, 1e5)
        )
        ratios.append(thin / thick)
    wanted = 0.5 * abs(ratios[1] - ratios[0])
    assert [run.u_exposure for run in given] == pytest.approx([wanted, 0.0], rel=0.05)
    assert 0.003 < wanted < 0.03


@pytest.mark.slow
def test_a_run_too_short_for_the_waveform_is_refused(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As short runs are fitted: without the evidence of the waveform."""

    def short(record: Path, *, air_known: bool) -> AnalysedRun:
        run = fitted_once(record, air_known=air_known)
        fit = run.fitted["exact"]
        without = replace(fit, evidence=replace(fit.evidence, waveform=None))
        return replace(run, fitted={**run.fitted, "exact": without})

    monkeypatch.setattr("rig.prepare.lever.analyse_record", short)
    with pytest.raises(DataError, match="too short for the waveform"):
        calibrate_air(vanes, Filing(tmp_path / "c"))
    assert not (tmp_path / "c").exists()


def test_vanes_are_advised_and_asked_for() -> None:
    config = complete(configuration(0.0))
    advised = vanes_to_cut(config, 4.071)
    assert advised is not None
    # half of the paper's pendulum, 0.55 m; what they add follows from Stokes's oscillating wall
    assert advised.distance_m == pytest.approx(0.27, abs=0.02)
    assert 0.03 < advised.area_m2 < 0.1
    # air that nobody has stated is that of an ordinary room
    room = {"temperature_c": 20.0, "humidity_percent": 50.0, "pressure_pa": 101325.0}
    stated = vanes_to_cut(complete(configuration(0.0, environment=room)), 4.071)
    thin = vanes_to_cut(complete(configuration(0.0, environment=room | {"pressure_pa": 6e4})), 4.071)
    assert stated is not None
    assert thin is not None
    assert advised.area_m2 == pytest.approx(stated.area_m2, rel=1e-3)
    assert thin.area_m2 != pytest.approx(stated.area_m2, rel=1e-2)


def test_the_air_acts_once_on_a_pendulum_on_two_balls() -> None:
    """Its drag was expected twice as large, as if each ball's half of the weight swung in the whole air."""
    expected = []
    for balls, kind in ((1, "single_ball"), (2, "two_ball")):
        pendulum = {
            "mass_kg": 1.2, "ball_radius_m": 5e-3, "ball_material": "steel", "flat_material": "glass_k8",
            "length_m": 0.5, "width_m": 0.1,
        }  # fmt: skip
        tree = {
            "camera": {"driver": "simulated"}, "instrument": {"kind": kind}, "pendulum": pendulum,
            "simulation": {"contact": {"balls": balls}},
        }  # fmt: skip
        config = validate_configuration(tree, "test")
        on_ball = pendulum_on_ball(config)
        assert on_ball is not None
        cut = vanes_to_cut(config, 4.0)
        assert cut is not None
        drag_s = expected_drag(AmbientConditions(), on_ball, 4.0, config).drag_s
        expected.append((drag_s, cut.drag_s, cut.area_m2))
    assert expected[1] == pytest.approx(expected[0], rel=1e-12)


def test_the_drag_falls_with_the_pressure_as_in_a_pumped_chamber() -> None:
    """The vapour of the room stayed at its pressure in a vacuum, so that the drag fell below zero."""
    config = complete(configuration(0.0))
    pendulum = pendulum_on_ball(config)
    assert pendulum is not None
    room, tenth, low, lower = (
        drag_at_pressure(pressure_pa, pendulum, 4.071, config) for pressure_pa in (101325.0, 1e4, 3e-5, 3e-6)
    )
    assert room == pytest.approx(expected_drag(AmbientConditions(), pendulum, 4.071, config).drag_s, rel=1e-4)
    # air that is pumped keeps its composition: its humidity falls as its pressure
    damp = AmbientConditions(humidity_percent=50.0 * 1e4 / 101325.0, pressure_pa=1e4)
    assert tenth == pytest.approx(expected_drag(damp, pendulum, 4.071, config).drag_s, rel=1e-3)
    # molecules that meet only the bar, thrown back by a rough wall: integrated over its circumference
    bar = expected_drag(AmbientConditions(), pendulum, 4.071, config)
    theta = 2 * np.pi * np.arange(720) / 720
    density = 3e-5 * bar.air_density_kg_per_m3 / 101325.0
    mean_speed = np.sqrt(8 * 3e-5 / (np.pi * density))
    push = (1 / 2 + np.pi / 8) * np.cos(theta) ** 2 + np.sin(theta) ** 2 / 4
    per_length = density * mean_speed * np.pi * bar.width_m * np.mean(push)
    weight_moment = pendulum.mass_kg * pendulum.gravity_m_per_s2 * pendulum.ball_radius_m
    assert low == pytest.approx(per_length * bar.length_m**3 / 12 / weight_moment, rel=0.01)
    assert low == pytest.approx(10 * lower, rel=0.01)
    assert low < 1e-3 * room


@pytest.mark.slow
def test_the_ratio_of_drags_is_that_of_one_pendulum(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its length followed the mean period of each run, which depends on the run's amplitudes."""
    seen: list[float] = []

    def caught(runs: Any, *_: Any, **__: Any) -> Any:
        seen.extend(run.exposure for run in runs)
        raise DataError("caught")

    monkeypatch.setattr("rig.prepare.lever.analyse_record", fitted_once)
    monkeypatch.setattr("rig.prepare.lever.air_of_vanes", caught)
    path = vanes.parent / "same.toml"
    path.write_text(
        "".join(f"[[run]]\nrecord = '{n}.mcap'\npressure_pa = {9e4 + n * 1e-6}\n" for n in (0, 1))
    )
    with pytest.raises(DataError, match="caught"):
        calibrate_air(path, Filing(tmp_path / "c"))
    assert seen == pytest.approx([1.0, 1.0], rel=1e-9)
