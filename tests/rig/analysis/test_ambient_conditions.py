"""Air and history of a contact in results, and the drag that is expected of the air."""

import json
from datetime import timedelta
from math import isnan
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from processing.ambient import AmbientConditions
from processing.errors import ConfigurationError
from rig.analysis.air import ambient_warnings, recorded_surroundings
from rig.instrument import recorded_configuration
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS


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
        found = recorded_surroundings(reader, recorded_configuration(reader, stated))
        assert found.dwell_s == pytest.approx(7200.0)
        assert found.age_s == pytest.approx(86400.0)
        assert (found.humidity_percent, found.pressure_pa) == (43.0, 98500.0)
        assert isnan(found.temperature_c)
        assert ambient_warnings(found) == []
        later = [f"session.contact_made={(began + timedelta(minutes=10)).isoformat()}"]
        (doubt,) = ambient_warnings(recorded_surroundings(reader, recorded_configuration(reader, later)))
        assert doubt == "session.contact_made lies 600 s after the run began: correct its date or offset"
        # the record's own texts, for who has no configuration
        assert recorded_surroundings(reader) == AmbientConditions()


def test_a_time_without_its_offset_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"should be a time with its offset from UTC, such as 2026"):
        load_configuration(CONFIGS / "demo.toml", ["session.contact_made=2026-11-22T09:30:00"])


def test_results_have_the_drag_of_air_beside_the_fitted_one(measured_series: Path) -> None:
    """About 2 ms for the paper's pendulum; nothing of the air or the bar was stated."""
    run = json.loads((measured_series / "results.json").read_text())["runs"][0]
    found = run["drag"]["of_air"]
    assert 1e-3 < found["drag_s"] < 3e-3
    assert found["air_density_kg_per_m3"] == pytest.approx(1.199, rel=0.01)
    assumed = ["temperature_c", "humidity_percent", "pressure_pa", "length_m", "width_m"]
    assert found["assumed"] == assumed
    assert set(run["surroundings"]) == {
        "temperature_c",
        "humidity_percent",
        "pressure_pa",
        "temperature_change_k",
        "dwell_s",
        "age_s",
    }


def test_readings_that_are_all_alike_have_not_changed(
    monkeypatch: pytest.MonkeyPatch, measured_series: Path
) -> None:
    kind = [(name, float) for name in ("temperature_c", "humidity_percent", "pressure_pa")]
    readings = np.array([(23.46, 41.3, 99870.0)] * 37, kind)
    monkeypatch.setattr(RecordReader, "table", lambda *_: readings)
    with RecordReader(measured_series / "run-1.mcap") as reader:
        found = recorded_surroundings(reader)
    assert found.temperature_change_k == 0.0
    assert found.temperature_c == pytest.approx(23.46)
