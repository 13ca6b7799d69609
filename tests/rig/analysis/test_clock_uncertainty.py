"""How uncertain the second of a run is, by what its record shows of the clocks."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.record.reader import RecordReader
from rig.analysis.contact_verdicts import rig_quantities
from rig.analysis.record_fit import run_clock
from rig.instrument import recorded_configuration
from rig.measure import simulate_record
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, SMALL

LIVE = ["simulation.real_time=true"]
WORDS = {**SMALL, "session.max_duration_s": "60", "preflight.when": '"never"'}


def recorded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A minute on demand, with arrivals as of a real camera."""
    usual, rng = SimulatedCamera.read, np.random.default_rng(1)

    def read(camera: SimulatedCamera, timeout_s: float) -> Frame | None:
        frame = usual(camera, timeout_s)
        if frame is None:
            return None
        late_ns = round(1e6 + 2e5 * abs(rng.standard_normal()))
        return frame._replace(host_time_ns=10**13 + frame.device_time_ns + late_ns)

    folder.mkdir()
    record = folder / "run.mcap"
    config = load_configuration(CONFIGS / "demo.toml", [f"{key}={value}" for key, value in WORDS.items()])
    with monkeypatch.context() as patch:
        patch.setattr(SimulatedCamera, "read", read)
        assert simulate_record(config, CONFIGS / "demo.toml", record) == 0
    return record


def test_an_assumed_rate_is_as_uncertain_as_its_clocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = recorded(tmp_path / "run", monkeypatch)
    with RecordReader(record) as reader:
        calibrated = [*LIVE, "timebase.camera_rate=1.0", "timebase.u_camera_rate=2e-6"]
        contradicted = [*LIVE, "timebase.camera_rate=1.001", "timebase.u_camera_rate=2e-6"]
        u_assumed, u_calibrated, u_contradicted = (
            clock.u_rate
            for words in (LIVE, calibrated, contradicted)
            if (clock := run_clock(reader, recorded_configuration(reader, words))) is not None
        )
        assert run_clock(reader, recorded_configuration(reader)) is None
        assert rig_quantities(recorded_configuration(reader, LIVE), u_clock=u_assumed).clock.u == u_assumed
    # of a computer that follows no time server
    assert u_assumed == pytest.approx(50e-6, rel=0.1)
    assert u_calibrated == pytest.approx(2e-6, rel=0.01)
    assert u_contradicted == pytest.approx(1e-3, rel=0.1)
