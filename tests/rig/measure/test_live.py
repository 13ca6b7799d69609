"""Two live runs in real time from start to end: one with the display on a terminal, one with faults.

What runs on demand is processed as fast as it goes; only here do watchers, forecasts and late frames meet a
clock.
"""

import os
import re
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from tests.rig.command_line import CONFIGS, QUICK, Session, rig, run, set_words
from tests.rig.pseudo_terminal import rig_at_terminal

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.timeout(300),
]

LIVE = {
    "simulation.real_time": "true",
    "simulation.sensor.width_px": "96",
    "simulation.sensor.height_px": "320",
    "simulation.optics.arm_m": "0.5",
    "camera.frame_rate_hz": "25",
    "start.way": '"at once"',
    "preflight.when": '"never"',
    # of a pendulum that loses half its swing in less than half a minute, as the twin does
    "simulation.contact.b": "0.03",
    "session.final_amplitude_arcsec": "52",
    "session.max_duration_s": "100",
    "simulation.ground.model": '"none"',
    "simulation.disturbances.air_arcsec": "0",
    "simulation.disturbances.pointing_walk_px_per_sqrt_s": "0",
}
DRIFT_PPM = 80.0
"""Of a camera's clock that nobody has calibrated."""


@pytest.mark.skipif(os.name != "posix", reason="a pseudo-terminal is POSIX's")
def test_a_run_comes_to_its_end_on_a_terminal_and_says_what_an_uncalibrated_clock_does(
    tmp_path: Path,
) -> None:
    """The same swing by a true clock, made on demand, says what the period is."""
    drifting = LIVE | {"simulation.clock.drift_ppm": f"{DRIFT_PPM:g}"}
    live, twin = Session(tmp_path / "live"), Session(tmp_path / "twin")
    words = ["run", str(CONFIGS / "basement.toml"), "-o"]
    at = rig_at_terminal(*words, live.folder, *set_words(drifting), cwd=tmp_path, columns=200)
    screen = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", at.stdout)
    assert "Traceback" not in screen
    entry = live.entries[-1]
    assert (entry["state"], entry["reason"]) == ("complete", "final amplitude reached")
    on_demand = set_words(LIVE | {"simulation.real_time": "false"})
    with patch("rig.measure.run.live_posterior", return_value=None):
        assert "Traceback" not in rig(*words, twin.folder, *on_demand).stderr
    (found,), (true,) = live.runs, twin.runs
    clock = found["clock"]
    assert clock["drift_ppm"] == pytest.approx(DRIFT_PPM, abs=max(4 * clock["u_drift_ppm"], 1.0))
    assert re.search(r"clock +\+(79|80)\.\d+ ± [\d.]+ ppm against", screen), screen[-3000:]
    rows, truth = ({row["quantity"]: row for row in each["table"]} for each in (found, true))
    # over the half-cycles of both: a busy machine loses frames, and with them some of the live run's
    assert slower(live.record, twin.record) == pytest.approx(1e-6 * DRIFT_PPM, rel=0.05)
    period_s, true_s = rows["mean_period_s"], truth["mean_period_s"]["value"]
    shift_s = 1e-6 * DRIFT_PPM * true_s
    assert abs(period_s["value"] - true_s) < 2.0 * period_s["u"]
    budget = found["budget"]["period0_s"]
    (line,) = [source for source in budget["sources"] if source["source"] == "clock"]
    # no less and not much more than what is there: 50 ppm of the computer's are added
    assert 0.9 * DRIFT_PPM < 1e6 * line["u_source"] < 2.0 * DRIFT_PPM
    assert 0.9 * shift_s < line["contribution"] <= budget["standard_uncertainty"]
    assert "clock" not in [one["source"] for one in true["budget"]["period0_s"]["sources"]]
    # γ follows from ratios of periods, which no rate changes
    gamma = found["budget"]["gamma_pa"]
    assert abs(gamma["value"] - 28.97e6) < 3.0 * gamma["standard_uncertainty"]


def slower(live: Path, twin: Path) -> float:
    """By what part the times between turning points of one record are longer than those of another."""
    times_ns = []
    for record in (live, twin):
        with RecordReader(record) as reader:
            times_ns.append({one.index: one.turn_time_ns for one in reader.half_cycles() if not one.flags})
    both = sorted(times_ns[0].keys() & times_ns[1].keys())
    assert len(both) > 8
    of_live, of_twin = (np.array([found[index] - found[both[0]] for index in both]) for found in times_ns)
    return float(np.polyfit(of_twin, of_live - of_twin, 1)[0])


SOONER = {
    **QUICK,
    "preflight.duration_s": "1.0",
    "phases.rest_window_s": "2.0",
    "phases.warm_up_window_s": "2.1",
    "faults.laser_fades_at_s": "12",
    "faults.laser_fade_duration_s": "1",
    "faults.vibration_burst_at_s": "14",
    "faults.draught_at_s": "16",
    "faults.camera_unplugged_at_s": "17",
    "faults.camera_replugged_at_s": "19",
    "session.max_duration_s": "14",
    "controller.watchdog_s": "5.0",
}
"""The faults of `faults.toml`, in half of the time."""


def test_all_faults_at_once_leave_a_record_that_says_what_happened(tmp_path: Path) -> None:
    session = run(tmp_path / "out", SOONER, config="faults.toml")
    assert "Traceback" not in session.said
    assert session.record.exists(), session.said
    with RecordReader(session.record) as reader:
        assert not reader.truncated
        losses, events = reader.losses(), reader.events()
    kinds, end = {event.kind for event in events}, end_of(events)
    assert {"rest", "warm-up", "preflight", "release", "start", "stop"} <= kinds
    assert {"spot lost", "spot found", "camera lost", "camera back"} <= kinds
    assert losses is not None
    assert losses.while_unplugged > 50
    assert end is not None
    assert end.kind == EventKind.STOP
    assert session.entries[-1]["state"] == "complete"
