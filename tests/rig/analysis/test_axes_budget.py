"""Of results: uncertain directions of the axes in the budget, air and history of a contact, expected drag."""

import json
from dataclasses import asdict, replace
from datetime import timedelta
from math import isnan
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from calibration.axes_fit import Axes
from calibration.shutter import Shutter
from processing.ambient import AmbientConditions
from processing.arrays import Floats
from processing.deflections import Deflections, DeflectionUnit
from processing.fit import FitResult, InputQuantity
from processing.fit.uncertainty import budgets
from rig.analysis.ambient import ambient_warnings, recorded_ambient
from rig.analysis.contact_verdicts import rig_quantities
from rig.analysis.passing_deflections import PassingDeflections
from rig.instrument import complete, recorded_configuration
from rig.settings import load_configuration
from tests.processing.fit.test_uncertainty import exact, points, rig
from tests.rig.view.replay_record import CONFIG

__all__ = ["exact", "points"]


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize(
    ("angle", "apart", "off", "opened"),
    [(0.3, 0.1, 0.02, -0.01), (0.0, 0.0, 0.05, 0.03), (-1.0, -0.2, -0.03, 0.0)],
)
def test_the_slow_tilt_that_wrong_axes_show(
    angle: float, apart: float, off: float, opened: float, mirrored: bool
) -> None:
    """Against a decomposition along the assumed axes of a motion along the true ones."""
    assumed = Axes(slow_angle_rad=angle, non_orthogonality_rad=apart, mirrored=mirrored)
    true = Axes(slow_angle_rad=angle + off, non_orthogonality_rad=apart + opened, mirrored=mirrored)
    ratio = 0.1
    seen = np.linalg.inv(assumed.directions()) @ true.directions() @ np.array([ratio, 1.0])
    # seen mirrored, the same fast deflection has the other sign on the sensor
    quantities = replace(
        rig(slow_angle_rad=InputQuantity(angle), non_orthogonality_rad=InputQuantity(apart)),
        fast_ratio=-ratio if mirrored else ratio,
    )
    shown = quantities.seen_slow_tilt(np.array([angle + off]), np.array([apart + opened]))
    assert shown[0] == pytest.approx(seen[1], rel=1e-12)


def test_uncertain_axes_stand_in_the_budget(exact: FitResult) -> None:
    u_rad, ratio, apart = 2e-3, 0.05, 0.01
    uncertain = replace(
        rig(slow_angle_rad=InputQuantity(0.2, u_rad), non_orthogonality_rad=InputQuantity(apart, u_rad)),
        fast_ratio=ratio,
    )
    budget = budgets(exact, uncertain)["c"]
    parts = {line.source: line.contribution for line in budget.sources}
    # c is in proportion to the assumed angles, and changes a little through R/a
    per_scale = budget.value + exact.by_log_rho[exact.names.index("c")]
    assert parts["non_orthogonality_rad"] == pytest.approx(abs(per_scale) * ratio * u_rad, rel=1e-3)
    assert parts["slow_angle_rad"] == pytest.approx(abs(per_scale) * (ratio - apart) * u_rad, rel=1e-3)
    # known axes change no number
    inputs = {name: np.array([quantity.value]) for name, quantity in rig().inputs().items()}
    assert rig().seen_slow_tilt(inputs["slow_angle_rad"], inputs["non_orthogonality_rad"])[0] == 1.0
    assert "slow_angle_rad" not in {line.source for line in budgets(exact, rig())["c"].sources}


def test_the_configuration_states_them() -> None:
    config = complete(load_configuration(CONFIG))
    axes = Axes(
        slow_angle_rad=0.1, u_slow_angle_rad=1e-3, non_orthogonality_rad=0.02, u_non_orthogonality_rad=3e-3
    )
    quantities = rig_quantities(config.model_copy(update={"axes": axes}), 0.01)
    assert quantities is not None
    assert quantities.slow_angle_rad == InputQuantity(0.1, 1e-3)
    assert quantities.non_orthogonality_rad == InputQuantity(0.02, 3e-3)
    assert quantities.fast_ratio == 0.01
    assert quantities.row_time_s == InputQuantity(0.0)
    rolling = rig_quantities(config.model_copy(update={"shutter": Shutter(15e-6, 2e-7)}))
    assert rolling is not None
    assert rolling.row_time_s == InputQuantity(15e-6, 2e-7)


def test_the_fast_mode_is_compared_with_the_slow_one() -> None:
    phase = np.linspace(0.0, 20 * np.pi, 5001)[:-1]
    slow = 3.0 + np.sin(phase)
    assert fast_ratio(0.1 * np.sin(5 * phase), slow) == pytest.approx(0.1, rel=1e-3)
    assert fast_ratio(np.full(5000, np.nan), slow) == 0.0
    assert fast_ratio(slow, np.zeros(5000)) == 0.0


def fast_ratio(x: Floats, y: Floats) -> float:
    """In blocks, the first of which has passed before."""
    every = Deflections(np.arange(len(x)), x, y, np.ones(len(x)), np.ones(len(x)), DeflectionUnit.RAD)
    passing = PassingDeflections([every[:700], every[:0], every[700:]], every.unit)
    assert len(next(iter(passing))) == 700
    ratio = passing.fast_ratio()
    assert (passing.frames, passing.first_ns, passing.last_ns) == (len(x), 0, len(x) - 1)
    return ratio


def test_dwell_and_age_are_counted_to_the_first_frame(measured_series: Path) -> None:
    record = measured_series / "run-1.mcap"
    with RecordReader(record) as reader:
        began = reader.utc(int(reader.spots()["time_ns"][0]))
        assert abs(began.timestamp() - record.stat().st_mtime) < 86400
        made, cleaned = began - timedelta(hours=2), began - timedelta(days=1)
        stated = [
            f"session.contact_made={made.isoformat()}",
            f"session.surfaces_cleaned={cleaned.isoformat()}",
            "environment.humidity_percent=43",
            "environment.pressure_pa=98500",
        ]
        exact = recorded_ambient(reader, recorded_configuration(reader, stated))
        assert exact.dwell_s == pytest.approx(7200.0)
        assert exact.age_s == pytest.approx(86400.0)
        assert (exact.humidity_percent, exact.pressure_pa) == (43.0, 98500.0)
        assert isnan(exact.temperature_c)
        assert ambient_warnings(exact) == []
        (doubt,) = ambient_warnings(replace(exact, humidity_percent=0.45))
        assert doubt.endswith("state humidity_percent = 45")
        later = [f"session.contact_made={(began + timedelta(minutes=10)).isoformat()}"]
        (doubt,) = ambient_warnings(recorded_ambient(reader, recorded_configuration(reader, later)))
        assert doubt == "session.contact_made lies 600 s after the run began: correct its date or offset"
        exchanged = [
            f"session.contact_made={cleaned.isoformat()}",
            f"session.surfaces_cleaned={made.isoformat()}",
        ]
        (doubt,) = ambient_warnings(recorded_ambient(reader, recorded_configuration(reader, exchanged)))
        assert doubt.startswith("session.surfaces_cleaned lies 79200 s after session.contact_made")
        # the record's own texts, for who has no configuration
        assert recorded_ambient(reader) == AmbientConditions()


def test_results_have_the_drag_of_air_beside_the_fitted_one(measured_series: Path) -> None:
    """About 2 ms for the paper's pendulum; nothing of the air or the bar was stated."""
    run = json.loads((measured_series / "results.json").read_text())["runs"][0]
    exact = run["drag"]["of_air"]
    assert 1e-3 < exact["drag_s"] < 3e-3
    assert exact["air_density_kg_per_m3"] == pytest.approx(1.199, rel=0.01)
    assumed = ["temperature_c", "humidity_percent", "pressure_pa", "length_m", "width_m"]
    assert exact["assumed"] == assumed
    assert set(run["ambient"]) == set(asdict(AmbientConditions()))


@pytest.mark.parametrize(
    ("read_at", "slope_k", "change_k"),
    [
        (np.linspace(0, 1, 37), 0.0, 0.0),
        # a sensor that was silent, and one that broke: the change by the readings' numbers was 1.7 and 0.6 K
        (np.concatenate([np.linspace(0, 0.5, 20), [0.98, 0.99, 1.0]]), 2.0, 2.0),
        (np.linspace(0, 0.3, 20), 2.0, np.nan),
    ],
)
def test_the_temperature_changes_by_the_times_of_its_readings(
    monkeypatch: pytest.MonkeyPatch,
    measured_series: Path,
    read_at: np.ndarray,
    slope_k: float,
    change_k: float,
) -> None:
    kind = [
        ("time_ns", np.int64),
        *((n, float) for n in ("temperature_c", "humidity_percent", "pressure_pa")),
    ]
    with RecordReader(measured_series / "run-1.mcap") as reader:
        lasted_ns = reader.numbers.end_ns - reader.numbers.start_ns
        readings = np.array([(lasted_ns * x, 23.46 + slope_k * x, 41.3, 99870.0) for x in read_at], kind)
        monkeypatch.setattr(RecordReader, "table", lambda *_: readings)
        exact = recorded_ambient(reader)
    assert exact.temperature_change_k == pytest.approx(change_k, nan_ok=True, rel=1e-6)
    assert exact.temperature_c == pytest.approx(float(np.mean(readings["temperature_c"])))
