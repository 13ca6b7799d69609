"""A whole session from the command line, on the simulated rig."""

import json
import math
import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from acquisition.frames.queue import BoundedQueue
from acquisition.record.reader import RecordReader
from acquisition.simulation.true_path import true_turning_points
from processing.swing import HalfCycleFlag
from rig.instrument.provenance import frame_shape, recorded_configuration
from rig.measure.session import measure_session
from rig.settings import load_configuration
from rig.view.replay import Replay
from tests.rig.command_line import CONFIGS, QUICK, SMALL, rig, set_words
from tests.waiting import until

TRUTH = {"b": 37.33e-4, "p": 0.944, "c": 10.51e-9, "n": 0.092, "period0_s": 4.071, "gamma_pa": 28.97e6}
LIMITS = {"b": 0.05, "p": 0.01, "c": 0.03, "n": 0.005, "period0_s": 0.005, "gamma_pa": 0.005}
"""In air, whose drag the waveform tells from friction: at 10 frames a second b is known to 2 %."""


def results_of(folder: Path) -> dict[str, Any]:
    tree: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return tree


@pytest.mark.slow
def test_a_session_leaves_records_and_results(measured_series: Path) -> None:
    tree = results_of(measured_series)
    assert tree["schema"] == 1
    assert [run["record"] for run in tree["runs"]] == ["run-1.mcap", "run-2.mcap"]
    for run in tree["runs"]:
        assert run["dropped_frames"] == 0
        # 70 s at 50 frames a second, and at most a block more
        assert 3500 <= run["frames"] <= 3564
        assert run["half_cycles"] >= 30
        (initial,) = [row for row in run["table"] if row["quantity"] == "initial_amplitude"]
        assert initial["value"] == pytest.approx(124, rel=0.02)
        for fit in run["fits"].values():
            for name in TRUTH:
                assert fit[name]["standard_uncertainty"] > 0
    # each run has noise of its own
    assert tree["runs"][0]["sha256"] != tree["runs"][1]["sha256"]
    with (
        RecordReader(measured_series / "run-1.mcap") as reader,
        RecordReader(measured_series / "run-2.mcap") as other,
    ):
        assert not (reader.spots()["x_px"][:100] == other.spots()["x_px"][:100]).any()
        kinds = [event.kind for event in reader.events()]
        assert kinds[0] == "start"
        assert kinds[-1] == "stop"
        assert "gap" not in kinds
        assert "time limit" in reader.events()[-1].text
        assert "configuration.json" in reader.attachments
        assert reader.metadata["session"]["operator"] == "demonstration"
        assert not reader.truncated
        (message,) = reader.messages("/camera_calibration")
        height_px, width_px = frame_shape(reader)
    seen = CameraCalibration.FromString(message.data)
    assert (seen.width, seen.height) == (width_px, height_px)
    # the lever of the series: 1 m away, pixels of 4.8 um, its reference in the sensor's middle
    middle = [0.5 * (width_px - 1), 0.5 * (height_px - 1)]
    distance_px = pytest.approx(1.0 / 4.8e-6)
    assert list(seen.K) == [distance_px, 0, middle[0], 0, distance_px, middle[1], 0, 0, 1]


@pytest.mark.slow
def test_replay_is_equal_bit_for_bit_and_retracking_within_a_tenth_of_the_uncertainty(
    measured_series: Path,
) -> None:
    for retrack in (False, True):
        with RecordReader(measured_series / "run-1.mcap") as reader:
            replay = Replay(reader, recorded_configuration(reader), retrack=retrack)
            assert sum(len(numbers) for numbers, _ in replay.blocks())
            comparison = replay.finish().comparison
        assert comparison.identical or retrack
        assert comparison.spots.largest_u < 0.1
        assert comparison.half_cycles.replayed == comparison.half_cycles.recorded > 0
        assert comparison.half_cycles.largest_u < 0.1


@pytest.mark.slow
def test_a_folder_that_holds_a_run_is_never_written_over(measured_series: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in measured_series.iterdir()}
    done = rig("run", CONFIGS / "demo.toml", "-o", measured_series)
    assert done.returncode == 2
    assert "run-1.mcap: exists already and is not overwritten" in done.stderr
    assert done.stderr.count("\n") == 1
    assert {path: path.stat().st_mtime_ns for path in measured_series.iterdir()} == before


def test_too_few_swings_are_said_and_the_record_kept(tmp_path: Path) -> None:
    words = set_words({**SMALL, "session.max_duration_s": "9"})
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *words)
    assert done.returncode == 1
    assert "needs at least 10" in done.stdout
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        assert len(reader.spots()) >= 450


def test_no_spot_at_all_is_recorded_as_such(tmp_path: Path) -> None:
    words = set_words({**SMALL, "simulation.optics.peak_dn": "0", "session.max_duration_s": "5"})
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *words, figures=True)
    assert done.returncode == 1
    assert "0 half-cycles" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert not (tmp_path / "out" / "report" / "run-1" / "fig12-decay.svg").exists()
    with RecordReader(tmp_path / "out" / "run-1.mcap") as reader:
        assert "spot lost" in [event.kind for event in reader.events()]
        assert all(math.isnan(x) for x in reader.spots()["x_px"])
        assert len(list(reader.images())) >= 4


@pytest.mark.slow
def test_a_spot_that_leaves_the_sensor_gives_no_wrong_swing(tmp_path: Path) -> None:
    words = set_words({
        **SMALL,
        "camera.frame_rate_hz": "25",
        "simulation.sensor.height_px": "440",
        "session.max_duration_s": "40",
    })  # fmt: skip
    record = tmp_path / "run.mcap"
    done = rig("run", CONFIGS / "demo.toml", "--record-only", "-o", record, *words)
    assert "Traceback" not in done.stderr
    with RecordReader(record) as reader:
        kinds = [event.kind for event in reader.events()]
        swings = reader.swings()
    assert "spot lost" in kinds
    # 124 arcsec are 250 px, the sensor ends at 220 px: more than an eighth of these half-cycles is outside
    gap = HalfCycleFlag.GAP
    assert [swing.flags for swing in swings[:17]] == [gap, gap, gap, gap, 0, gap, *11 * [0]]
    # what is reported must be right all the same
    truth = true_turning_points(load_configuration(CONFIGS / "demo.toml").simulation, max_duration_s=45)
    first_ns = round(1e9 * load_configuration(CONFIGS / "demo.toml").simulation.clock.start_s)
    for swing in (swing for swing in swings if swing.flags == 0):
        time_s = (swing.turn_time_ns - first_ns) * 1e-9
        nearest = int(np.argmin(np.abs(truth.time_s - time_s)))
        assert abs(time_s - truth.time_s[nearest]) < 5 * swing.u_turn_time_s
        assert abs(swing.amplitude - abs(truth.angle_rad[nearest])) < 5 * swing.u_amplitude


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_ctrl_c_closes_the_record_and_fits_what_there_is(tmp_path: Path) -> None:
    endless = {
        **QUICK,
        "simulation.real_time": "false",
        "session.final_amplitude_arcsec": "0.001",
        "session.max_duration_s": "1000000",
    }
    record = tmp_path / "out" / "run-1.mcap"

    def press() -> None:
        until(lambda: record.exists() and record.stat().st_size > 250_000)
        os.kill(os.getpid(), signal.SIGINT)

    pressing = threading.Thread(target=press)
    pressing.start()
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", *set_words(endless))
    pressing.join()
    assert "stopped by the user" in done.stderr
    (run,) = results_of(tmp_path / "out")["runs"]
    assert run["half_cycles"] >= 10
    with RecordReader(record) as reader:
        assert not reader.truncated
        assert reader.events()[-1].text == "stopped by the user"


@pytest.mark.slow
@pytest.mark.usefixtures("no_fits_meanwhile")
def test_the_demonstration_finds_the_truth(tmp_path: Path) -> None:
    # a hundredth of the pixels: every pixel of the demonstration is seen where README is executed
    less = {**SMALL, "camera.frame_rate_hz": "6", "simulation.sensor.width_px": "96"}
    done = rig("run", CONFIGS / "demo.toml", "-o", tmp_path / "out", "--runs", "1", *set_words(less))
    assert done.returncode == 0, done.stderr
    run = results_of(tmp_path / "out")["runs"][0]
    assert run["dropped_frames"] == 0
    (final,) = [row for row in run["table"] if row["quantity"] == "final_amplitude"]
    assert final["value"] < 2.0
    for name, truth in TRUTH.items():
        found = run["fits"]["exact"][name]
        assert found["value"] == pytest.approx(truth, rel=LIMITS[name]), name
        assert abs(found["value"] - truth) < 3 * found["standard_uncertainty"], name


@pytest.mark.parametrize("real_time", [False, True])
def test_a_slow_camera_ends_at_the_time_limit(tmp_path: Path, real_time: bool) -> None:
    rate_hz, limit_s = (1.0, 2) if real_time else (0.1, 10)
    words = set_words({
        **SMALL,
        "camera.frame_rate_hz": f"{rate_hz}",
        "camera.timeout_s": "0.5",
        "session.max_duration_s": f"{limit_s}",
        "simulation.real_time": str(real_time).lower(),
        "preflight.when": '"never"',
    })  # fmt: skip
    record = tmp_path / "slow.mcap"
    assert rig("run", CONFIGS / "demo.toml", "--record-only", "-o", record, *words).returncode == 0
    with RecordReader(record) as reader:
        assert reader.events()[-1].text == f"time limit of {limit_s} s reached"
        assert sum(map(len, reader.spot_blocks())) == rate_hz * limit_s + 1


@pytest.mark.parametrize("rate_hz", [10, 200])
def test_runs_of_other_rates_end_and_count_every_frame(rate_hz: int, tmp_path: Path) -> None:
    words = set_words({**QUICK, "camera.frame_rate_hz": str(rate_hz), "session.max_duration_s": "12"})
    record = tmp_path / "run.mcap"
    done = rig("run", CONFIGS / "basement.toml", "--record-only", "-o", record, *words)
    assert done.returncode == 0, done.stderr
    with RecordReader(record) as reader:
        assert reader.events()[-1].text == "time limit of 12 s reached"
        sequences, losses = reader.spots()["sequence"].tolist(), reader.losses()
    # the run ends with a block of frames
    assert 12 * rate_hz <= len(sequences) <= 12 * rate_hz + 64
    assert losses is None or losses.total == 0
    assert sequences == list(range(len(sequences)))


def test_a_run_on_demand_ends_at_the_same_frame_however_frames_arrive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take, frames = BoundedQueue.take, []
    source = CONFIGS / "demo.toml"
    words = [f"{key}={value}" for key, value in {**QUICK, "session.max_duration_s": "5"}.items()]
    for most in (64, 1):

        def take_some(queue: BoundedQueue[Any], at_most: int, wait_s: float, most: int = most) -> list[Any]:
            return take(queue, min(at_most, most), wait_s)

        monkeypatch.setattr(BoundedQueue, "take", take_some)
        folder = tmp_path / f"{most}"
        measure_session(load_configuration(source, words), source, folder)
        with RecordReader(folder / "run-1.mcap") as reader:
            frames.append(len(reader.spots()))
    # four whole blocks, where five seconds end with frame 251
    assert frames == [256, 256]
