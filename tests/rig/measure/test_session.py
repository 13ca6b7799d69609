"""A whole session from the command line, on the simulated rig."""

import math
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from acquisition.frames.queue import BoundedQueue
from acquisition.record.reader import RecordReader
from acquisition.simulation.true_path import true_turning_points
from processing.errors import ConfigurationError
from processing.swing import HalfCycleFlag
from rig.instrument.provenance import frame_shape, recorded_configuration
from rig.measure import record_plainly, session_folder
from rig.settings import load_configuration
from rig.view.replay import Replay
from tests.rig.acting import acting
from tests.rig.command_line import CONFIGS, QUICK, SMALL, Session, configured, events_of, rig, run, set_words
from tests.waiting import until

TRUTH = {"b": 37.33e-4, "p": 0.944, "c": 10.51e-9, "n": 0.092, "period0_s": 4.071, "gamma_pa": 28.97e6}
LIMITS = {"b": 0.05, "p": 0.01, "c": 0.03, "n": 0.005, "period0_s": 0.005, "gamma_pa": 0.005}
"""In air, whose drag the waveform tells from friction: at 10 frames a second b is known to 2 %."""


@pytest.mark.slow
def test_a_session_leaves_records_and_results(measured_series: Path) -> None:
    session = Session(measured_series)
    assert [one["record"] for one in session.runs] == ["run-1.mcap", "run-2.mcap"]
    for one in session.runs:
        assert one["dropped_frames"] == 0
        # 70 s at 50 frames a second, and at most a block more
        assert 3500 <= one["frames"] <= 3564
        assert one["half_cycles"] >= 30
        (initial,) = [row for row in one["table"] if row["quantity"] == "initial_amplitude"]
        assert initial["value"] == pytest.approx(124, rel=0.02)
        for fit in one["fits"].values():
            assert all(fit[name]["standard_uncertainty"] > 0 for name in TRUTH)
    # each run has noise of its own
    assert session.runs[0]["sha256"] != session.runs[1]["sha256"]
    kinds = [kind for kind, _ in session.events]
    assert (kinds[0], kinds[-1]) == ("start", "stop")
    assert "gap" not in kinds
    assert "time limit" in session.events[-1][1]
    with RecordReader(session.record) as reader, RecordReader(session.folder / "run-2.mcap") as other:
        assert not (reader.spots()["x_px"][:100] == other.spots()["x_px"][:100]).any()
        assert "configuration.json" in reader.attachments
        assert reader.metadata["session"]["operator"] == "demonstration"
        (message,) = reader.messages("/camera_calibration")
        height_px, width_px = frame_shape(reader)
    seen = CameraCalibration.FromString(message.data)
    assert (seen.width, seen.height) == (width_px, height_px)
    # the lever of the series: 1 m away, pixels of 4.8 um, its reference in the sensor's middle
    distance_px = pytest.approx(1.0 / 4.8e-6)
    x_px, y_px = 0.5 * (width_px - 1), 0.5 * (height_px - 1)
    assert list(seen.K) == [distance_px, 0, x_px, 0, distance_px, y_px, 0, 0, 1]


@pytest.mark.slow
def test_retracking_is_equal_within_a_tenth_of_the_uncertainty(measured_series: Path) -> None:
    with RecordReader(measured_series / "run-1.mcap") as reader:
        replay = Replay(reader, recorded_configuration(reader), retrack=True)
        assert sum(len(numbers) for numbers, _ in replay.blocks())
        comparison = replay.finish().comparison
    assert comparison.spots.largest_u < 0.1
    assert comparison.half_cycles.replayed == comparison.half_cycles.recorded > 0
    assert comparison.half_cycles.largest_u < 0.1


@pytest.mark.parametrize("name", ["run-1.mcap", "results.json"])
def test_a_folder_that_holds_a_run_is_never_written_over(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    with pytest.raises(ConfigurationError, match="holds a run already, which is never overwritten"):
        session_folder(configured({}), CONFIGS / "demo.toml", tmp_path)


def test_a_run_ends_at_its_final_amplitude_in_arcsec(tmp_path: Path) -> None:
    wanted = {**QUICK, "session.final_amplitude_arcsec": "118", "session.max_duration_s": "60"}
    record_plainly(configured(wanted), CONFIGS / "demo.toml", tmp_path / "run-1.mcap")
    assert events_of(tmp_path / "run-1.mcap")[-1] == ("stop", "final amplitude reached")


def test_no_spot_at_all_is_recorded_as_such(tmp_path: Path) -> None:
    dark = set_words({**SMALL, "simulation.optics.peak_dn": "0", "session.max_duration_s": "5"})
    folder = tmp_path / "out"
    session = Session(folder, rig("run", CONFIGS / "demo.toml", "-o", folder, *dark, figures=True))
    assert session.done.returncode == 1
    assert "0 half-cycles" in (folder / "report.html").read_text(encoding="utf-8")
    assert not (folder / "report" / "run-1" / "fig12-decay.svg").exists()
    assert "spot lost" in dict(session.events)
    with RecordReader(session.record) as reader:
        assert all(math.isnan(x) for x in reader.spots()["x_px"])
        assert len(list(reader.images())) >= 4


@pytest.mark.slow
def test_a_spot_that_leaves_the_sensor_gives_no_wrong_swing(tmp_path: Path) -> None:
    less = {**SMALL, "camera.frame_rate_hz": "25", "simulation.sensor.height_px": "440"}
    config = configured({**less, "session.max_duration_s": "40"})
    record_plainly(config, CONFIGS / "demo.toml", tmp_path / "run.mcap")
    with RecordReader(tmp_path / "run.mcap") as reader:
        assert "spot lost" in {event.kind for event in reader.events()}
        half_cycles = reader.half_cycles()
    # 124 arcsec are 250 px, the sensor ends at 220 px: more than an eighth of these half-cycles is outside
    gap = HalfCycleFlag.GAP
    assert [h.flags for h in half_cycles[:17]] == [gap, gap, gap, gap, 0, gap, *11 * [0]]
    # what is reported must be right all the same
    simulation = load_configuration(CONFIGS / "demo.toml").simulation
    truth = true_turning_points(simulation, max_duration_s=45)
    for half_cycle in (h for h in half_cycles if h.flags == 0):
        time_s = half_cycle.turn_time_ns * 1e-9 - simulation.clock.start_s
        nearest = int(np.argmin(np.abs(truth.time_s - time_s)))
        assert abs(time_s - truth.time_s[nearest]) < 5 * half_cycle.u_turn_time_s
        assert abs(half_cycle.amplitude - abs(truth.angle_rad[nearest])) < 5 * half_cycle.u_amplitude


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_ctrl_c_closes_the_record_and_fits_what_there_is(tmp_path: Path) -> None:
    endless = {**QUICK, "session.final_amplitude_arcsec": "0.001", "session.max_duration_s": "1000000"}
    record = tmp_path / "out" / "run-1.mcap"

    def press() -> None:
        until(lambda: record.exists() and record.stat().st_size > 250_000)
        os.kill(os.getpid(), signal.SIGINT)

    with acting(press):
        session = run(tmp_path / "out", endless)
    assert "stopped by the user" in session.said
    assert session.runs[0]["half_cycles"] >= 10
    assert session.events[-1][1] == "stopped by the user"


@pytest.mark.slow
@pytest.mark.usefixtures("no_fits_meanwhile")
def test_the_demonstration_finds_the_truth(tmp_path: Path) -> None:
    # a hundredth of the pixels: every pixel of the demonstration is seen where README is executed
    less = {**SMALL, "camera.frame_rate_hz": "6", "simulation.sensor.width_px": "96"}
    session = run(tmp_path / "out", less, "--runs", "1")
    assert session.done.returncode == 0, session.said
    (measured,) = session.runs
    assert measured["dropped_frames"] == 0
    (final,) = [row for row in measured["table"] if row["quantity"] == "final_amplitude"]
    assert final["value"] < 2.0
    for name, truth in TRUTH.items():
        found = measured["fits"]["exact"][name]
        assert found["value"] == pytest.approx(truth, rel=LIMITS[name]), name
        assert abs(found["value"] - truth) < 3 * found["standard_uncertainty"], name


SLOW = {**SMALL, "camera.timeout_s": "0.5"}


@pytest.mark.parametrize(
    ("config", "values", "rate_hz", "limit_s", "frames"),
    [
        ("demo", {**SLOW, "simulation.real_time": "true"}, 1.0, 2, (3, 3)),
        ("demo", SLOW, 0.1, 10, (2, 2)),
        # the run ends with a block of frames
        ("basement", QUICK, 10.0, 12, (120, 184)),
        ("basement", QUICK, 200.0, 5, (1000, 1064)),
    ],
)
def test_runs_of_all_rates_end_at_the_time_limit_and_count_every_frame(
    tmp_path: Path, config: str, values: dict[str, str], rate_hz: float, limit_s: int, frames: tuple[int, int]
) -> None:
    of_it = {"camera.frame_rate_hz": f"{rate_hz}", "session.max_duration_s": f"{limit_s}"}
    record, words = tmp_path / "run.mcap", set_words({**values, **of_it, "preflight.when": '"never"'})
    done = rig("run", CONFIGS / f"{config}.toml", "--record-only", "-o", record, *words)
    assert done.returncode == 0, done.stderr
    with RecordReader(record) as reader:
        assert reader.events()[-1].text == f"time limit of {limit_s} s reached"
        sequences, losses = reader.spots()["sequence"].tolist(), reader.losses()
    assert frames[0] <= len(sequences) <= frames[1]
    assert losses is None or losses.total == 0
    assert sequences == list(range(len(sequences)))


def test_a_run_on_demand_ends_at_the_same_frame_however_frames_arrive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take, frames = BoundedQueue.take, []
    for most in (64, 1):

        def take_some(queue: BoundedQueue[Any], at_most: int, wait_s: float, most: int = most) -> list[Any]:
            return take(queue, min(at_most, most), wait_s)

        monkeypatch.setattr(BoundedQueue, "take", take_some)
        record = tmp_path / f"{most}.mcap"
        record_plainly(configured({**QUICK, "session.max_duration_s": "5"}), CONFIGS / "demo.toml", record)
        with RecordReader(record) as reader:
            frames.append(len(reader.spots()))
    # four whole blocks, where five seconds end with frame 251
    assert frames == [256, 256]
