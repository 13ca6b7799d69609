"""An auxiliary seismometer beside a run: recorded with its frames, and fitted with no further word."""

import itertools
import os
import pty
import threading
import time
import tty
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.topics import SEISMOMETER
from processing.errors import ConfigurationError
from rig.analysis import analyse_record, read_results
from rig.analysis.ambient import recorded_seismometer
from rig.instrument import recorded_configuration
from rig.intake import read_seismometer
from rig.measure import measure_session, record_plainly
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS, QUICK, configured
from tests.rig.conftest import APPARATUS

GROUND = (
    "session.max_duration_s=200",
    "simulation.ground.model='white'",
    "simulation.ground.white_m_per_s2_per_sqrt_hz=2e-5",
    "seismometer.kind='simulated'",
    "simulation.seismometer.noise_m_per_s2_per_sqrt_hz=1e-6",
    "simulation.seismometer.delay_s=0.05",
    "fit.drag='vacuum'",
)


@pytest.fixture(scope="module")
def vault(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of one run on ground that shakes, with a seismometer beside it."""
    folder = tmp_path_factory.mktemp("vault") / "run"
    source = CONFIGS / "demo.toml"
    small = ("simulation.sensor.height_px=640", "simulation.sensor.width_px=96", "camera.frame_rate_hz=25")
    wanted = (*small, *APPARATUS, *GROUND)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rig.measure.run.live_posterior", lambda _: None)
        assert measure_session(load_configuration(source, wanted), source, folder) == 0
    return folder


@pytest.mark.slow
def test_its_samples_stand_in_the_record_on_the_clock_of_the_frames(vault: Path) -> None:
    with RecordReader(vault / "run-1.mcap") as reader:
        table, spots = reader.table(SEISMOMETER.topic), reader.spots()
        config = recorded_configuration(reader)
        found = recorded_seismometer(reader, config)
    assert len(table) == pytest.approx(20 * 200, abs=50)
    assert np.all(np.diff(table["time_ns"]) == 50_000_000)
    assert 0 <= table["time_ns"][0] - spots["time_ns"][0] < 50_000_000
    assert 0 <= spots["time_ns"][-1] - table["time_ns"][-1] < 50_000_000 + 64 * 40_000_000
    assert np.all(np.isnan(table["third"]))
    assert found is not None
    assert found.names == ("along", "across")
    assert found.value[:, 0].tolist() == table["first"].tolist()


@pytest.mark.slow
def test_the_run_itself_is_fitted_with_it_and_so_is_its_record(vault: Path) -> None:
    (run,) = read_results(vault).runs
    assert run.seismometer is not None
    assert run.seismometer.used
    assert [response.name for response in run.seismometer.responses] == ["along"]
    assert run.seismometer.explained > 0.9
    # it is late by 0.05 s, which is in the response's phase; so short a run bounds it
    delay_s, u_s = run.seismometer.delay_s
    assert abs(delay_s + 0.05) < 3 * u_s < 0.5
    alone = analyse_record(vault / "run-1.mcap", ["seismometer.kind='none'"])
    assert alone.seismometer is None
    exact = alone.fits["exact"]
    assert exact.ground is not None
    before, left = run.seismometer.ground_alone_rad_per_s2_rthz, run.seismometer.ground_left_rad_per_s2_rthz
    assert before == exact.ground.density_rad_per_s2_rthz
    # lever of the mass centre over the stiffness, times the ground's acceleration
    assert before.value == pytest.approx(2e-5 * 2e-4 / (9.81 * 6.05e-3) * (2 * np.pi / 4.16) ** 2, rel=0.35)
    assert left.value < 0.3 * before.value


@pytest.mark.slow
def test_a_file_beside_a_record_is_accepted_in_its_place(vault: Path, tmp_path: Path) -> None:
    record, (own,) = vault / "run-1.mcap", read_results(vault).runs
    assert own.seismometer is not None
    with RecordReader(record) as reader:
        table = reader.table(SEISMOMETER.topic)
        first_ns, epoch_ns = int(reader.spots()["time_ns"][0]), reader.epoch_offset_ns
    # by UTC, and in seconds of which nobody says when they began
    for name, zero_ns in (("utc.csv", -epoch_ns), ("relative.csv", first_ns)):
        rows = zip((table["time_ns"] - zero_ns).tolist(), table["first"].tolist(), strict=True)
        lines = [f"{time_ns // 10**9}.{time_ns % 10**9:09d},{value:.9g}" for time_ns, value in rows]
        (tmp_path / name).write_text("\n".join(["time_s,counts", *lines]))
        found = analyse_record(record, seismometer=read_seismometer(tmp_path / name))
        assert found.seismometer is not None
        assert found.seismometer.used, name
        assert [response.name for response in found.seismometer.responses] == ["counts"]
        assert found.seismometer.explained == pytest.approx(own.seismometer.explained, abs=0.01)
        one, other = (run.fits["exact"].estimate("b") for run in (own, found))
        assert other.value == pytest.approx(one.value, abs=0.3 * one.standard_uncertainty)


def test_one_that_does_not_go_with_the_camera_is_said(tmp_path: Path) -> None:
    for keys, said in (
        ({"kind": "'serial'", "port": "'/dev/none'"}, r"seismometer\.kind = 'serial' samples in real time"),
        ({"kind": "'simulated'"}, r"set simulation\.ground\.model"),
    ):
        config = configured({f"seismometer.{key}": value for key, value in keys.items()})
        with pytest.raises(ConfigurationError, match=said):
            measure_session(config, CONFIGS / "demo.toml", tmp_path / "run")


@pytest.mark.slow
def test_a_serial_seismometer_is_recorded_beside_frames_that_come_in_real_time(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    over = threading.Event()
    skipped = range(100, 120)

    def write() -> None:
        begun_s = time.monotonic()
        for k in itertools.count():
            while k not in skipped and not over.is_set():
                # full once nobody reads any more
                with suppress(BlockingIOError):
                    os.write(master, b"%.4f %d %d\r\n" % (100.0 + 0.02 * k, k, -k))
                    break
                over.wait(0.02)
            if over.wait(max(0.0, begun_s + 0.02 * (k + 1) - time.monotonic())):
                return

    writing = threading.Thread(target=write)
    writing.start()
    wanted = {
        **QUICK,
        "session.max_duration_s": "5",
        "simulation.real_time": "true",
        "preflight.when": "'never'",
        "seismometer.kind": "'serial'",
        "seismometer.port": f"'{os.ttyname(slave)}'",
        "seismometer.columns": "['time_s', 'z', 'n']",
    }
    record = tmp_path / "run-1.mcap"
    try:
        record_plainly(configured(wanted), CONFIGS / "demo.toml", record)
    finally:
        over.set()
        writing.join()
        os.close(master)
        os.close(slave)
    with RecordReader(record) as reader:
        table, spots = reader.table(SEISMOMETER.topic), reader.spots()
        found = recorded_seismometer(reader, recorded_configuration(reader))
    assert found is not None
    assert found.names == ("z", "n")
    number = found.value[:, 0]
    assert np.array_equal(found.value[:, 1], -number)
    assert set(skipped).isdisjoint(number.astype(int).tolist())
    # every line of these 5 s, each once, and none from before the record
    steps = np.diff(number)
    assert np.all((steps == 1) | (steps == len(skipped) + 1))
    assert len(number) > 150
    assert np.all(table["time_ns"] >= spots["time_ns"][0])
    # its own clock spaces them, wherever threads waited
    own_s = table["own_time_s"] - table["own_time_s"][0]
    taken_s = found.times_ns * 1e-9
    assert np.polyfit(own_s, taken_s, 1)[0] == pytest.approx(1.0, abs=0.05)
    assert taken_s - np.polyval(np.polyfit(own_s, taken_s, 1), own_s) == pytest.approx(0.0, abs=1e-6)
