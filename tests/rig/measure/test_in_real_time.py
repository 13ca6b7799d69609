"""Sessions whose controller moves the simulated rig, for which they wait."""

from pathlib import Path

import pytest

from acquisition.record.reader import RecordReader
from processing.units import ARCSEC_RAD
from tests.rig.command_line import CONFIGS, SMALL, rig, run, set_words

pytestmark = pytest.mark.slow

MAGNET = {
    **SMALL,
    "start.way": '"magnet"',
    "preflight.duration_s": "1.0",
    "phases.rest_window_s": "2.0",
    "phases.warm_up_window_s": "2.1",
    "session.max_duration_s": "12",
    # a program that a busy machine holds up for longer than usual is no trip of its own
    "controller.watchdog_s": "5.0",
}


def test_a_magnet_holds_and_lets_go(tmp_path: Path) -> None:
    session = run(tmp_path / "out", MAGNET, config="live.toml")
    assert "Traceback" not in session.said
    assert session.record.exists(), session.said
    with RecordReader(session.record) as reader:
        half_cycles = [h for h in reader.half_cycles() if h.flags == 0]
    kinds, texts = [kind for kind, _ in session.events], dict(session.events)
    assert kinds.count("rest") == 2  # free, then held
    assert kinds.index("preflight") < kinds.index("magnet") < kinds.index("release") < kinds.index("start")
    held_arcsec = float(texts["magnet"].removeprefix("holds the pendulum at ").split()[0])
    # where it was held it starts from: 124 arcsec, less the first quarter cycle's loss and noise
    assert held_arcsec == pytest.approx(124.0, abs=0.5)
    assert half_cycles[0].amplitude / ARCSEC_RAD == pytest.approx(held_arcsec, rel=0.02)
    assert texts["stop"].startswith("time limit")


def test_a_magnet_that_holds_nothing_is_said(tmp_path: Path) -> None:
    # held at 2 arcsec: less than what counts as motion
    weak = run(tmp_path / "out", MAGNET, config="live.toml", simulation__release__amplitude_arcsec="2")
    assert weak.done.returncode == 1
    assert "the magnet does not hold the pendulum" in weak.said
    assert not list(weak.folder.glob("*.mcap"))


@pytest.mark.parametrize("rate_hz", [25, 100])
def test_a_perfect_rig_is_a_go_at_every_rate(tmp_path: Path, rate_hz: int) -> None:
    output = {"session.output": f"'{tmp_path.as_posix()}'"}
    words = set_words({**SMALL, **output, "camera.frame_rate_hz": str(rate_hz), "preflight.duration_s": "3"})
    done = rig("doctor", "--preflight", CONFIGS / "live.toml", "--json", *words)
    assert done.returncode == 0, done.stderr
    assert "too few" not in done.stdout


def test_the_starter_of_a_live_rig_starts_the_swing_that_is_balanced(tmp_path: Path) -> None:
    words = ("balance", CONFIGS / "live.toml", "--history-file", tmp_path / "history.jsonl")
    done = rig(*words, "--set", "simulation.sensor.width_px=160", typed="q\n")
    assert "no swing was seen" not in done.stderr
    assert "balanced: within all limits\n" in done.stdout
