"""Live runs in real time from their start to their end, with the display on a terminal, and with faults.

What runs on demand is processed as fast as it goes; only here do watchers, forecasts and late frames meet a
clock. Processor time is what counts on a busy machine: the sensors are small, and the runs, which wait for
frames, are made at once.
"""

import json
import os
import re
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from tests.rig.command_line import CONFIGS, rig, set_words
from tests.rig.pseudo_terminal import Terminal

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.timeout(300),
    pytest.mark.skipif(os.name != "posix", reason="a pseudo-terminal is POSIX's"),
]

LIVE = {
    "simulation.real_time": "true",
    "simulation.sensor.width_px": "96",
    "simulation.sensor.height_px": "160",
    "simulation.optics.arm_m": "0.5",
    "camera.frame_rate_hz": "25",
    "start.way": '"at once"',
    "preflight.when": '"never"',
    "view.file": "false",
}
FROM_7_ARCSEC = {
    "session.initial_amplitude_arcsec": "7",
    "simulation.release.amplitude_arcsec": "7",
    # friction and air of a pendulum that is done in a minute
    "simulation.contact.b": "0.05",
    "session.max_duration_s": "100",
}
LASTING_20_S = {"session.max_duration_s": "20"}
FAULTS = {
    "faults.camera_unplugged_at_s": "4",
    "faults.camera_replugged_at_s": "7",
    "faults.laser_fades_at_s": "10",
    "faults.laser_fade_duration_s": "1",
    "faults.draught_at_s": "14",
}
DRIFT_PPM = 80.0
"""Of a camera's clock that nobody has calibrated."""
FAST_CLOCK = {
    "session.max_duration_s": "40",
    "simulation.sensor.height_px": "320",
    "simulation.ground.model": '"none"',
    "simulation.disturbances.air_arcsec": "0",
    "simulation.disturbances.pointing_walk_px_per_sqrt_s": "0",
}
RUNS: Mapping[str, dict[str, str]] = {
    "from 7 arcsec": LIVE | FROM_7_ARCSEC,
    "10/s": LIVE | LASTING_20_S | {"camera.frame_rate_hz": "10"},
    "200/s": LIVE | LASTING_20_S | {"camera.frame_rate_hz": "200"},
    "faults": LIVE | LASTING_20_S | FAULTS,
    "clock": LIVE | LASTING_20_S | {"faults.clock_zero_at_s": "5", "faults.clock_steps_at_s": "10"},
    "fast clock": LIVE | FAST_CLOCK | {"simulation.clock.drift_ppm": f"{DRIFT_PPM:g}"},
    "32 bits": LIVE | LASTING_20_S | {"faults.clock_bits": "32"},
}


class Live(NamedTuple):
    """Where a run was made, and what was on its screen."""

    folder: Path
    screen: str

    @property
    def record(self) -> Path:
        return self.folder / "run-1.mcap"

    @property
    def state(self) -> tuple[str, str]:
        entry = json.loads((self.folder / "session.json").read_text())["entries"][-1]
        return entry["state"], entry["reason"]


def at_a_terminal(folder: Path, values: dict[str, str]) -> Live:
    """Run at a pseudo-terminal whose screen is read."""
    words = set_words(values)
    terminal = Terminal("run", CONFIGS / "basement.toml", "-o", folder, *words, on_screen=True)
    try:
        while terminal.process.poll() is None:
            terminal._read(0.5)
        terminal.end()
        return Live(folder, terminal.screen)
    finally:
        terminal.close()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Future[Live]]]:
    """All runs, which are being made."""
    folder = tmp_path_factory.mktemp("live")
    with ThreadPoolExecutor(len(RUNS)) as together:
        yield {
            name: together.submit(at_a_terminal, folder / str(number), values)
            for number, (name, values) in enumerate(RUNS.items())
        }


Made = dict[str, Future[Live]]


def test_a_run_in_the_basement_from_7_arcsec_comes_to_its_end_on_a_terminal(made: Made) -> None:
    run = made["from 7 arcsec"].result()
    assert "Traceback" not in run.screen
    assert run.state == ("complete", "final amplitude reached")
    (results,) = json.loads((run.folder / "results.json").read_text())["runs"]
    assert results["fits"], results["problem"]


@pytest.mark.parametrize("rate_hz", [10, 200])
def test_runs_of_other_rates_end_and_count_every_frame(rate_hz: int, made: Made) -> None:
    run = made[f"{rate_hz}/s"].result()
    assert "Traceback" not in run.screen
    assert run.state == ("complete", "time limit of 20 s reached")
    with RecordReader(run.record) as reader:
        sequences, losses = reader.spots()["sequence"], reader.losses()
    # the run ends with a block of frames, which are many where they had to wait
    assert 20 * rate_hz - 2 <= sequences[-1] < 20 * rate_hz + 64
    # a busy machine may lose some, after the last one too; none is missing without being counted
    lost = 0 if losses is None else losses.total
    assert 0 <= sequences[-1] + 1 - len(sequences) <= lost
    assert len(sequences) > rate_hz


def test_faults_are_survived_or_named(made: Made) -> None:
    run = made["faults"].result()
    assert "Traceback" not in run.screen
    assert run.state == ("complete", "time limit of 20 s reached")
    with RecordReader(run.record) as reader:
        events = reader.events()
        losses = reader.losses()
    kinds = [event.kind for event in events]
    found = {EventKind.CAMERA_LOST, EventKind.CAMERA_BACK, EventKind.SPOT_LOST, EventKind.SPOT_FOUND}
    assert found <= {*kinds}
    assert losses is not None
    assert losses.while_unplugged > 50
    end = end_of(events)
    assert end is not None
    assert end.kind == EventKind.STOP


@pytest.mark.parametrize(
    ("name", "said"),
    [("clock", ["time 0 ns", "stepped by +0.1"]), ("32 bits", ["begins again every 4.295 s"])],
)
def test_a_faulty_clock_is_named_and_its_times_go_on(name: str, said: list[str], made: Made) -> None:
    run = made[name].result()
    assert "Traceback" not in run.screen
    assert run.state == ("complete", "time limit of 20 s reached")
    with RecordReader(run.record) as reader:
        spots, events = reader.spots(), reader.events()
    told = " ".join(event.text for event in events if event.kind == EventKind.CAMERA_CLOCK)
    assert all(words in told for words in said), told
    # no step is left in the times: between frames lie 40 ms each
    frame_times_s = np.diff(spots["time_ns"]) / np.diff(spots["sequence"]) * 1e-9
    assert np.all(np.abs(frame_times_s - 0.04) < 0.02)


def test_what_an_uncalibrated_clock_does_is_said_and_in_the_budget(made: Made, tmp_path: Path) -> None:
    """The same swing by a true clock, made on demand, says what the period is."""
    run = made["fast clock"].result()
    twin = LIVE | FAST_CLOCK | {"simulation.real_time": "false"}
    done = rig("run", CONFIGS / "basement.toml", "-o", tmp_path / "twin", *set_words(twin))
    assert "Traceback" not in done.stderr
    (found,), (true,) = (
        json.loads((folder / "results.json").read_text())["runs"]
        for folder in (run.folder, tmp_path / "twin")
    )
    clock = found["clock"]
    assert clock["drift_ppm"] == pytest.approx(DRIFT_PPM, abs=max(4 * clock["u_drift_ppm"], 1.0))
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", run.screen)
    assert re.search(r"clock +\+(79|80)\.\d+ ± [\d.]+ ppm against", plain), plain[-3000:]
    shift_s = found["period_s"]["value"] - true["period_s"]["value"]
    assert shift_s / true["period_s"]["value"] == pytest.approx(1e-6 * DRIFT_PPM, rel=0.15)
    assert abs(shift_s) < 2.0 * found["period_s"]["standard_uncertainty"]
    budget = found["budget"]["period0_s"]
    (line,) = [source for source in budget["sources"] if source["source"] == "clock"]
    # no less and not much more than what is there: 50 ppm of the computer's are added
    assert 0.9 * DRIFT_PPM < 1e6 * line["u_source"] < 2.0 * DRIFT_PPM
    assert 0.9 * abs(shift_s) < line["contribution"] <= budget["standard_uncertainty"]
    assert "clock" not in [one["source"] for one in true["budget"]["period0_s"]["sources"]]
    # γ follows from ratios of periods, which no rate changes
    gamma = found["budget"]["gamma_pa"]
    assert abs(gamma["value"] - 28.97e6) < 3.0 * gamma["standard_uncertainty"]
