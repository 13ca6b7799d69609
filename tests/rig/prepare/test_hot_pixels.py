"""The hot pixels that the sensor's calibration has found are left out, live and in a replay."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.simulation.settings import SensorTruth
from rig.instrument.calibration import fill_from_files
from rig.instrument.provenance import recorded_configuration
from rig.measure.session import simulate_record
from rig.prepare import calibrate_sensor
from rig.prepare.calibration_inputs import Filing
from rig.settings import validate_configuration
from rig.view.replay import Replay
from tests.calibration.simulated_sensor import transfer_frames

SEED = 1
HOT = SensorTruth(width_px=100, height_px=120, hot_pixels=1500, hot_pixel_dn=4.0)


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a sensor of whose pixels one in eight is hot."""
    folder = tmp_path_factory.mktemp("transfer")
    pairs, darks, _ = transfer_frames(HOT, SEED)
    np.save(folder / "dark.npy", np.stack(darks))
    lines = ["darks = 'dark.npy'", "full_scale_dn = 255"]
    for number, pair in enumerate(pairs):
        np.save(folder / f"level-{number}.npy", np.stack(pair))
        lines += ["[[level]]", f"frames = 'level-{number}.npy'"]
    (folder / "transfer.toml").write_text("\n".join(lines))
    return calibrate_sensor(folder / "transfer.toml", Filing(folder))


def spots(record: Path, truth: SensorTruth, **sections: Any) -> np.ndarray:
    """(n, 4) x, y and their uncertainties of a pendulum at rest."""
    simulation = {
        "seed": SEED,
        "sensor": truth.model_dump(),
        "release": {"way": "by command"},
        "fast": {"amplitude_arcsec": 0.0},
        "max_duration_s": 1.0,
    }
    simulate_record(
        validate_configuration(
            {"camera": {"driver": "simulated"}, "simulation": simulation, **sections}, "test"
        ),
        record,
        record,
    )
    with RecordReader(record) as reader:
        table = reader.spots()
    return np.column_stack([table[name] for name in ("x_px", "y_px", "u_x_px", "u_y_px")])[10:]


@pytest.mark.slow
def test_the_map_takes_away_what_hot_pixels_do_and_a_replay_repeats_it(
    tmp_path: Path, calibration: Path
) -> None:
    in_use = {"camera": {"driver": "simulated"}, "calibration": {"sensor": str(calibration)}}
    sensor = fill_from_files(validate_configuration(in_use, "test")).sensor
    assert sensor is not None
    assert len(sensor.hot_pixels_xy) > 300
    stated = {
        name: getattr(sensor, name)
        for name in ("gain_e_per_dn", "read_noise_e", "full_scale_dn", "pedestal_dn")
    }
    cold = spots(tmp_path / "cold.mcap", HOT.model_copy(update={"hot_pixels": 0}))
    true_px, u_px = cold[:, :2].mean(axis=0), cold[:, 2:].mean(axis=0)
    biased = spots(tmp_path / "hot.mcap", HOT, sensor=stated)
    mapped = spots(tmp_path / "mapped.mcap", HOT, **in_use)
    in_u = [np.abs((found[:, :2].mean(axis=0) - true_px) / u_px).max() for found in (biased, mapped)]
    assert in_u[0] > 0.8
    assert in_u[1] < 0.5  # what is too dark for the map, and three standard deviations of the means
    with RecordReader(tmp_path / "mapped.mcap") as reader:
        replay = Replay(reader, recorded_configuration(reader), retrack=True)
        while replay.advance(np.inf, 1000) is not None:
            pass
        found = replay.finish()
    assert found.comparison.spots.largest_u < 1e-3
    assert found.beam.model is not None
