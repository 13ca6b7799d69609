"""`rig calibrate air`: runs with vanes, the file that they make, and a fit that uses it."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from calibration import read_calibration
from processing.ambient import AmbientConditions
from processing.errors import ConfigurationError, DataError
from processing.estimate import Estimate
from processing.fit import FitMethod, MeasuredAir, drag_verdict
from rig.analysis import AnalysedRun, analyse_record, remarks
from rig.analysis.ambient import expected_drag
from rig.instrument import complete, pendulum_on_ball
from rig.measure import record_plainly
from rig.prepare import Filing, calibrate_air
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
        "clock": {"frame_rate_hz": 12.5},
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
        assert record_plainly(configuration(area_m2), folder / "none.toml", record) == 0
        lines += ["[[run]]", f"record = '{record.name}'", f"area_m2 = {area_m2}"]
    (folder / "vanes.toml").write_text("\n".join(lines))
    return folder / "vanes.toml"


@pytest.mark.slow
def test_the_drag_is_measured_filed_and_used(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.prepare.air.analyse_record", fitted_once)
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
        ("[[run]]\nrecord = '0.mcap'\narea_m2 = 0.0", "two different areas"),
        ("[[run]]\nrecord = '0.mcap'", "run 1: area_m2: is missing"),
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
    monkeypatch.setattr("rig.prepare.air.analyse_record", fitted_once)
    swapped = vanes.parent / "swapped.toml"
    swapped.write_text(
        vanes.read_text().replace("0.mcap", "x").replace("1.mcap", "0.mcap").replace("x", "1.mcap")
    )
    with pytest.raises(DataError, match="s per m² of vanes, but vanes add drag: check which record"):
        calibrate_air(swapped, Filing(tmp_path / "c"))
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(("slope", "said"), [(-2.1, "refused"), (-1.9, "hint"), (1.9, "hint"), (2.1, "")])
def test_vanes_that_take_drag_away_are_refused_and_those_that_add_none_are_named(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slope: float, said: str
) -> None:
    """By two standard uncertainties of the slope, in either direction."""
    fit = SimpleNamespace(evidence=SimpleNamespace(waveform="seen"), mean_period_s=Estimate(4.0, 1e-6))
    run = SimpleNamespace(
        fitted={FitMethod.EXACT: fit}, pendulum=pendulum_on_ball(complete(configuration(0.0))), points=None,
        ambient=None, measured_again_on=1,
    )  # fmt: skip
    drag_s, per_area = Estimate(DRAG_S, 1e-5), Estimate(1e-3 * slope, 1e-3)
    air = MeasuredAir(drag_s, per_area, {}, (), (), 1.0, 1, 0.5, 1.0)
    monkeypatch.setattr("rig.prepare.air.analyse_record", lambda *_, **__: run)
    monkeypatch.setattr("rig.prepare.air.air_of_vanes", lambda *_: air)
    if said == "refused":
        with pytest.raises(DataError, match=r"drags fall by 0\.0021 ± 0\.001 s per m² of vanes"):
            calibrate_air(vanes, Filing(tmp_path / "c"))
        return
    notes = read_calibration(calibrate_air(vanes, Filing(tmp_path / "c")), "air").notes
    assert any("the vanes add no significant drag" in note for note in notes) is (said == "hint")
    assert any("at three" in note for note in notes)
    assert len(notes) == 1 + (said == "hint"), "nothing else is to be said"


@pytest.mark.slow
def test_a_run_that_was_not_measured_twice_is_named(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def second_as_detected(record: Path, *, air_known: bool) -> AnalysedRun:
        run = fitted_once(record, air_known=air_known)
        return replace(run, measured_again_on=None) if record.name == "1.mcap" else run

    for analyse, named in ((fitted_once, False), (second_as_detected, True)):
        monkeypatch.setattr("rig.prepare.air.analyse_record", analyse)
        notes = read_calibration(calibrate_air(vanes, Filing(tmp_path / f"{named}")), "air").notes
        assert (
            any("turning points of run 2 could not be measured a second time" in one for one in notes)
            == named
        )


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

    monkeypatch.setattr("rig.prepare.air.analyse_record", short)
    with pytest.raises(DataError, match="too short for the waveform"):
        calibrate_air(vanes, Filing(tmp_path / "c"))
    assert not (tmp_path / "c").exists()


def test_runs_of_two_pendulums_are_refused(
    vanes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = [MagicMock(pendulum=number, ambient=None) for number in (1, 2)]
    monkeypatch.setattr("rig.prepare.air.analyse_record", MagicMock(side_effect=runs))
    monkeypatch.setattr("rig.prepare.air.expected_drag", MagicMock())
    with pytest.raises(DataError, match="its runs are of different pendulums: mass, ball or flat"):
        calibrate_air(vanes, Filing(tmp_path / "c"))


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
        expected.append(expected_drag(AmbientConditions(), on_ball, 4.0, config).drag_s)
    assert expected[1] == pytest.approx(expected[0], rel=1e-12)
