"""Preflight of a seismometer and of a reference: on made-up values, and beside the simulated vault."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.record.topics import RecordedSeismometer
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot, SpotFlag
from rig.control import SeismometerSettings
from rig.devices.ground_seismometer import check_seismometer
from rig.measure import preflight_rig
from rig.measure.preflight import TrialFrames, rest_checks
from rig.settings import ReferenceSettings, load_configuration
from rig.settings.sections import PreflightSettings
from rig.terminal import Verdict
from tests.processing.test_pendulum_at_rest import FRAMES_PER_S, shaken
from tests.rig.command_line import configured
from tests.rig.conftest import APPARATUS, CONFIGS

LIMITS = PreflightSettings()
SETTINGS = SeismometerSettings(kind="serial", port="/dev/any", columns=("z",))
Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def minute() -> tuple[TrialFrames, Floats]:
    """A minute of a pendulum at rest on ground that shakes, and the drive."""
    time_s, seen, drive = shaken(60.0, 1)
    return look_at(time_s, seen[0]), drive[0]


def look_at(time_s: Floats, y: Floats, *, resting: bool = True) -> TrialFrames:
    times_ns = np.rint(1e9 * time_s).astype(np.int64) + 5_000_000_000
    zeros = np.zeros(len(y))
    at = Deflections(times_ns, zeros, y, zeros + 1e-8, zeros + 1e-8, DeflectionUnit.RAD)
    return TrialFrames([], [], at, resting)


def samples(values: Floats) -> list[RecordedSeismometer]:
    step_ns = round(1e9 / FRAMES_PER_S)
    # late by a fixed time, in bursts of four
    return [
        RecordedSeismometer(5_080_000_000 + step_ns * (k - k % 4 + 4) + k % 4, 0, k / FRAMES_PER_S, one)
        for k, one in enumerate(values.tolist())
    ]


def judged(look: TrialFrames, of: Sequence[RecordedSeismometer], problem: str | None = "") -> Verdict:
    return rest_checks.seismometer(look, problem, SETTINGS, of, None)


def test_a_seismometer_says_what_it_would_give(minute: tuple[TrialFrames, Floats]) -> None:
    look, drive = minute
    verdict = judged(look, samples(1e9 * drive))
    assert (verdict.ok, verdict.reason) == (True, "")
    assert "squared coherence 0.9" in verdict.measured
    assert "the ground's part of it by" in verdict.measured


def test_an_unrelated_one_is_a_warning_and_a_dead_one_no_go(minute: tuple[TrialFrames, Floats]) -> None:
    look, drive = minute
    unrelated = np.random.default_rng(2).standard_normal(len(drive))
    for verdict, ok, said in (
        (judged(look, samples(unrelated)), True, "does not show what moves the pendulum"),
        (judged(look, samples(np.full(len(drive), 8192.0))), False, "z: constant over 1500 samples"),
        (judged(look, [], "no line has come"), False, "no line has come"),
    ):
        assert verdict.ok is ok
        assert said in verdict.reason
        assert verdict.remedy


def test_what_cannot_be_known_is_not_promised(minute: tuple[TrialFrames, Floats]) -> None:
    look, drive = minute
    times_s, y = look.deflections.times_s, look.deflections.y
    still = 1e-9 * np.random.default_rng(1).standard_normal(len(drive))
    short = judged(look_at(times_s[:150], y[:150]), samples(drive[:150]))
    quiet, swinging = (
        judged(look_at(times_s, at, resting=resting), samples(drive))
        for at, resting in ((still, True), (y, False))
    )
    assert [verdict.made for verdict in (short, quiet, swinging)] == [False] * 3
    assert (short.ok, short.measured) == (True, "serial, alive")
    assert "preflight.duration_s = 60 would measure it" in short.reason
    assert "the ground does not exceed the noise of the spot" in quiet.reason
    assert judged(look, [], None).measured == "none is configured"


def spots(y_px: Floats, x_px: Floats, *, lost: int = 0) -> list[Spot]:
    places = zip(x_px.tolist(), y_px.tolist(), strict=True)
    found = [Spot(x, y, 0.01, 0.01, 6.0, 6.0, 0.0, 100.0, 6.0, 1.0, 0) for x, y in places]
    return [one._replace(flags=SpotFlag.LOST) if k < lost else one for k, one in enumerate(found)]


def with_reference(gain: float, *, lost: int = 0) -> Verdict:
    rng = np.random.default_rng(7)
    time_s = np.arange(1500) / 25.0
    swing = 0.3 * np.cos(2 * np.pi * time_s / 4.1)
    beam = np.cumsum(0.01 * rng.standard_normal((2, 1500)), axis=1)
    noise = 0.01 * rng.standard_normal((4, 1500))
    at = look_at(time_s, 1e-6 * (swing + beam[0] + noise[0])).deflections
    ours = spots(300 + swing + beam[0] + noise[0], 80 + beam[1] + noise[1])
    theirs = spots(684 + beam[0] + noise[2], 80 + beam[1] + noise[3], lost=lost)
    look = TrialFrames([], ours, at, True, None, theirs)
    return rest_checks.reference(look, ReferenceSettings(from_row_px=646, gain=gain), LIMITS)


def test_a_reference_says_what_it_would_take_off() -> None:
    good = with_reference(1.0)
    assert (good.ok, good.reason) == (True, "")
    assert "found in 100 % of 1500 frames; x: 0." in good.measured
    assert "px fall by" in good.measured
    wrong = with_reference(2.0)
    assert wrong.ok
    assert "x shows a gain of" in wrong.reason
    assert "reference.gain = 2 is stated" in wrong.reason
    gone = with_reference(1.0, lost=400)
    assert gone.ok
    assert "let its beam fall below row 646" in gone.remedy


def test_the_vault_before_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wanted = (
        "simulation.sensor.width_px=160",
        "simulation.sensor.height_px=720",
        "camera.frame_rate_hz=25",
        *APPARATUS,
        f"session.output='{tmp_path.as_posix()}'",
        "start.way='by hand'",
        "preflight.duration_s=60",
        "simulation.release.amplitude_arcsec=0.01",
        "simulation.ground.model='white'",
        "simulation.ground.white_m_per_s2_per_sqrt_hz=2e-5",
        "simulation.optics.reference_y_px=319.5",
        "simulation.reference.x_px=80",
        "seismometer.kind='simulated'",
    )
    config = load_configuration(CONFIGS / "vault.toml", wanted)
    preflight_rig(config)
    said = " ".join(capsys.readouterr().out.split())
    assert "squared coherence 0.9" in said
    assert "the swing at rest" in said
    assert "px fall by" in said
    assert check_seismometer(config).ok


def test_the_doctor_waits_for_a_sample_and_says_that_none_came() -> None:
    silent = {"kind": "'serial'", "port": "'loop://'", "stale_after_s": "0.3"}
    wanted = {f"seismometer.{key}": value for key, value in silent.items()}
    verdict = check_seismometer(configured({"simulation.real_time": "true", **wanted}))
    assert (verdict.ok, verdict.reason) == (False, "no line has come")
    assert "port, rate and columns" in verdict.remedy
    assert not check_seismometer(configured({})).made
