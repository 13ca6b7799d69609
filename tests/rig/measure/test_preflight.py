"""Each check of the preflight: go and no-go from plain values, with reason and remedy."""

import math
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from acquisition.camera import Frame
from calibration import Axes, Shutter
from calibration.pointing import stability
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot, SpotFlag
from processing.units import ARCSEC_RAD
from rig.control import ControlState, LaserReport, Light, SafetyNow
from rig.measure.preflight import TrialFrames, frame_checks, rest_checks
from rig.settings import Configuration
from rig.settings.sections import PreflightSettings
from rig.terminal import failures
from rig.terminal.verdict import Verdict, print_verdicts
from tests.rig.control.test_states import opened

LIMITS = PreflightSettings()
NAMES = ("noise floor", "vibration", "spot found", "laser", "disk space")


def spots(count: int, *, amplitude_dn: float = 150.0, flags: int = 0) -> list[Spot]:
    return [Spot(1.0, 2.0, 0.01, 0.01, 6.0, 6.0, 0.0, amplitude_dn, 6.0, 1.0, flags)] * count


def frames(count: int, rate_hz: float = 100.0, *, jitter_s: float = 0.0, missing: int = 0) -> list[Frame]:
    noise = np.random.default_rng(5).normal(0.0, 1.0, (count, 2))
    image = np.zeros((4, 4), np.uint8)
    found = []
    for k in range(count):
        sequence = k if k < count // 2 else k + missing
        device_ns = round(1e9 * (1.0 + sequence / rate_hz + jitter_s * noise[k, 0]))
        found.append(Frame(image, sequence, device_ns, device_ns + 5_000_000 + abs(round(1e4 * noise[k, 1]))))
    return found


def assert_no(verdict: Verdict) -> None:
    assert not verdict.ok
    assert verdict.reason
    assert verdict.remedy


def assert_go(verdict: Verdict) -> None:
    """Nothing is to be done, and nothing is said against it."""
    assert verdict.ok
    assert not verdict.reason
    assert not verdict.remedy


def look(x: float, y: float, unit: DeflectionUnit) -> TrialFrames:
    """A hundred frames in which the spot stands still."""
    ones = np.ones(100)
    deflections = Deflections(np.arange(100) * 10_000_000, x * ones, y * ones, ones, ones, unit)
    return TrialFrames(frames(100), spots(100), deflections, True)


def test_the_disk_is_judged_by_the_rate_of_all_frames_not_of_the_whole_ones_that_memory_holds() -> None:
    """Of a large sensor only the newest frames are held whole: a fifth of them needed a fifth of the disk."""
    stated = {"camera": {"driver": "simulated"}, "session": {"max_duration_s": 1e4}}
    config = Configuration.model_validate(stated)
    whole = look(0.0, 0.0, DeflectionUnit.RAD)
    for frames_held in (100, 20):
        held = replace(whole, frames=whole.frames[-frames_held:], resting=False)
        verdicts = frame_checks.check_trial_frames(held, config, 255.0, 1000.0, 10**12)
        (limit,) = [verdict.limit for verdict in verdicts if verdict.name == "disk space"]
        assert limit == "1.3 GB for 10000 s", f"{frames_held} frames"


def test_spot_that_is_mostly_there() -> None:
    assert_go(frame_checks.spot_found(spots(1000), LIMITS))
    assert_no(frame_checks.spot_found(spots(98) + spots(2, flags=SpotFlag.LOST), LIMITS))
    assert_no(frame_checks.spot_found([], LIMITS))


@pytest.mark.parametrize(("amplitude_dn", "ok"), [(10.0, False), (60.0, True), (200.0, True), (245.0, False)])
def test_exposure_has_a_lower_and_an_upper_limit(amplitude_dn: float, ok: bool) -> None:
    verdict = frame_checks.exposure(spots(50, amplitude_dn=amplitude_dn), 255.0, LIMITS)
    assert verdict.ok is ok
    if not ok:
        assert_no(verdict)


def test_saturation() -> None:
    assert_go(frame_checks.saturation(spots(100), LIMITS))
    assert_no(frame_checks.saturation(spots(50, flags=SpotFlag.SATURATED) + spots(50), LIMITS))


def test_a_line_of_vibration_is_named_with_its_frequency() -> None:
    times = np.arange(2000) / 500.0
    noise = np.random.default_rng(3).normal(0.0, 0.01 * ARCSEC_RAD, 2000)
    quiet = stability(times, noise, np.full(2000, 0.01 * ARCSEC_RAD))
    shaken = stability(
        times, noise + 0.5 * ARCSEC_RAD * np.sin(2 * math.pi * 50.0 * times), np.full(2000, 0.01 * ARCSEC_RAD)
    )
    floor, still = rest_checks.noise_and_vibration(quiet, quiet, DeflectionUnit.RAD, LIMITS)
    assert floor.ok
    assert still.ok
    _, shaking = rest_checks.noise_and_vibration(quiet, shaken, DeflectionUnit.RAD, LIMITS)
    assert_no(shaking)
    assert "50.0 Hz (mains" in shaking.measured


SWINGING = TrialFrames([], [], Deflections(*[np.empty(0)] * 5, DeflectionUnit.RAD), False)


def test_a_swinging_pendulum_has_no_noise_floor_and_that_is_no_fault() -> None:
    verdicts = rest_checks.stillness(SWINGING, LIMITS)
    assert all(v.ok and not v.made and v.measured == "not measured" and v.reason for v in verdicts)


def test_a_resting_spot_seen_too_seldom_is_no_go() -> None:
    """Below 25 frames/s four seconds were too short, and that passed as go."""
    few = look(0.0, 0.0, DeflectionUnit.RAD)
    few = replace(few, deflections=few.deflections[:80])
    for verdict in rest_checks.stillness(few, LIMITS):
        assert_no(verdict)
        assert verdict.made


def test_what_was_not_checked_and_what_is_a_warning_is_not_called_go() -> None:
    verdicts = [
        *rest_checks.stillness(SWINGING, LIMITS),
        frame_checks.spot_found(spots(100), LIMITS),
        frame_checks.laser(LaserReport(Light.ON, 0.5e-3), goes_dark_by_itself=False),
        frame_checks.disk(1, 5000.0, 500.0, 3600.0),
    ]
    text = StringIO()
    print_verdicts(Console(file=text, width=100), verdicts)
    marks: dict[str, str] = {}
    for line in text.getvalue().splitlines():
        for name in NAMES:
            if name in line[:24]:
                marks.setdefault(name, line.split()[0])
    assert marks == {
        "noise floor": "-",
        "vibration": "-",
        "spot found": "go",
        "laser": "warn",
        "disk space": "NO",
    }
    assert "not checked: noise floor, vibration: the pendulum may be swinging" in text.getvalue()


def test_the_ground_is_said_once_the_look_is_long_enough() -> None:
    """A swing of 1 arcsec that nothing drives: a bound."""
    short = look(3e-8, 0.0, DeflectionUnit.RAD)
    said = rest_checks.ground(short, LIMITS)
    assert said.ok
    assert not said.made
    assert "preflight.duration_s" in said.reason
    times_ns = np.arange(1500, dtype=np.int64) * 40_000_000
    swing = ARCSEC_RAD * np.sin(2 * math.pi * times_ns * 1e-9 / 4.0)
    noise = np.random.default_rng(2).normal(0.0, 3e-8, 1500)
    u = np.full(1500, 3e-8)
    at = Deflections(times_ns, noise, swing + noise, u, u, DeflectionUnit.RAD)
    said = rest_checks.ground(replace(short, deflections=at), LIMITS)
    assert said.made
    assert said.measured.startswith("below ")
    assert said.measured.endswith("in 60 s")
    assert not rest_checks.ground(SWINGING, LIMITS).made
    # nothing drives it: it is quiet enough for any limit
    assert_go(rest_checks.ground(replace(short, deflections=at), asking(1e-9)))
    assert_no(rest_checks.ground(short, asking(1e-9)))


def asking(ground: float) -> PreflightSettings:
    return PreflightSettings(max_ground_rad_per_s2_rthz=ground)


def test_a_ground_above_its_limit_is_a_no_go() -> None:
    """A pendulum that the ground pushes in every period by chance: its quadratures wander."""
    rng = np.random.default_rng(5)
    times_s = np.arange(1500) * 0.04
    wander = 1e-7 * np.cumsum(rng.normal(size=(2, 1500)), axis=1)
    phase = 2 * math.pi * times_s / 4.0
    swing = wander[0] * np.sin(phase) + wander[1] * np.cos(phase) + rng.normal(0.0, 1e-8, 1500)
    times_ns, u = np.round(times_s * 1e9).astype(np.int64), np.full(1500, 1e-8)
    at = Deflections(times_ns, 0 * swing, swing, u, u, DeflectionUnit.RAD)
    shaken = replace(look(1e-8, 0.0, DeflectionUnit.RAD), deflections=at)
    said = rest_checks.ground(shaken, asking(1e-9))
    assert not said.ok
    assert said.limit == "1e-09 rad/s²/√Hz"
    assert "quieter hour" in said.remedy
    assert_go(rest_checks.ground(shaken, asking(1.0)))
    in_px = rest_checks.ground(replace(shaken, deflections=replace_unit(at)), asking(1e-9))
    assert in_px.ok
    assert in_px.reason == rest_checks.NO_LEVER


def replace_unit(at: Deflections) -> Deflections:
    return Deflections(at.times_ns, at.x, at.y, at.u_x, at.u_y, DeflectionUnit.PX)


def test_rest_position_far_from_the_reference() -> None:
    assert_go(rest_checks.rest_position(look(3e-8, 0.0, DeflectionUnit.RAD), LIMITS))
    assert_no(rest_checks.rest_position(look(3e-8, 70 * ARCSEC_RAD, DeflectionUnit.RAD), LIMITS))


def test_px_are_called_px_and_not_held_against_limits_in_arcsec() -> None:
    """Values that would be go, and values that would be no-go, if their px were taken for arcsec."""
    times = np.arange(2000) / 500.0
    noise = np.random.default_rng(3).normal(0.0, 1.0, 2000)
    for size_px in (0.0001, 10.0):
        shaken = stability(
            times,
            size_px * (noise + 50.0 * np.sin(2 * math.pi * 50.0 * times)),
            np.full(2000, size_px),
        )
        verdicts = [
            *rest_checks.noise_and_vibration(shaken, shaken, DeflectionUnit.PX, LIMITS),
            rest_checks.rest_position(look(size_px, 70 * size_px, DeflectionUnit.PX), LIMITS),
        ]
        for verdict in verdicts:
            assert " px" in verdict.measured
            assert "arcsec" not in verdict.measured
            assert verdict.ok
            assert not verdict.made
            assert verdict.reason.startswith("no lever")
            assert not verdict.remedy
        assert failures(verdicts) == ""


def test_clock_that_jitters() -> None:
    assert_go(frame_checks.clock(frames(200), LIMITS))
    assert_no(frame_checks.clock(frames(200, jitter_s=5e-4), LIMITS))
    assert_no(frame_checks.clock(frames(10), LIMITS))
    without = [frame._replace(device_time_ns=-1) for frame in frames(200)]
    assert_go(frame_checks.clock(without, LIMITS))


@pytest.mark.parametrize("faster", [8.0, 125.0, 1.002, 0.5])
def test_a_clock_that_counts_in_another_unit_is_no_go(faster: float) -> None:
    """A register in ticks taken for nanoseconds, for example."""
    wrong = [frame._replace(device_time_ns=round(frame.device_time_ns * faster)) for frame in frames(400)]
    verdict = frame_checks.clock(wrong, LIMITS)
    assert_no(verdict)
    assert f"{faster:.3g}"[:4] in verdict.reason
    made = frame_checks.clock(wrong, LIMITS, on_demand=True)
    assert "times as fast as the computer's" not in made.reason
    assert "ppm" not in made.measured


def test_a_clock_whose_rate_cannot_be_judged_is_unknown_and_not_go() -> None:
    """Frames that a busy computer read all at once, or seconds late."""
    rng = np.random.default_rng(3)
    late_ns = np.cumsum(np.rint(2e8 * rng.standard_normal(60) ** 2).astype(np.int64)) // 2
    late = [
        frame._replace(host_time_ns=frame.host_time_ns + int(ns))
        for frame, ns in zip(frames(60), late_ns, strict=True)
    ]
    verdict = frame_checks.clock(late, LIMITS)
    assert verdict.ok
    assert not verdict.made
    assert "rate unknown" in verdict.measured
    assert verdict.reason.startswith("unknown: ")
    assert "go" not in verdict.judgement_text.split(",")[0]


def test_frame_rate_and_losses() -> None:
    assert_go(frame_checks.frame_rate(frames(500), 100.0, LIMITS))
    slow = frame_checks.frame_rate(frames(500, 80.0), 100.0, LIMITS)
    assert_no(slow)
    assert "80.00 Hz" in slow.measured
    assert_no(frame_checks.frame_rate(frames(500, missing=10), 100.0, LIMITS))


def test_disk_holds_the_longest_run_or_not() -> None:
    assert_go(frame_checks.disk(10**10, 5000.0, 500.0, 3600.0))
    assert_no(frame_checks.disk(10**9, 5000.0, 500.0, 3600.0))
    nearly_full = frame_checks.disk(12_000, 5000.0, 50.0, 14.0)
    assert (nearly_full.measured, nearly_full.limit) == ("0.0 MB free", "3.5 MB for 14 s")


def test_a_rolling_shutter_is_advised_where_it_matters() -> None:
    across, along = Axes(slow_angle_rad=0.02), Axes(slow_angle_rad=math.pi / 2 - 0.05)
    for axes in (None, across):
        advised = frame_checks.shutter("Rolling", None, axes)
        assert advised.ok
        assert "row time unknown" in advised.measured
        assert "turn the camera" in advised.remedy
    assert not frame_checks.shutter("Rolling", None, along).remedy
    known = frame_checks.shutter("Rolling", Shutter(row_time_s=1.5e-5, u_row_time_s=2e-7), across)
    assert not known.remedy
    assert "15.00 ± 0.20 µs a row" in known.measured
    assert not frame_checks.shutter("GlobalReset", None, across).remedy
    assert not frame_checks.shutter("", None, across).made


def test_air_and_controller() -> None:
    nothing = (math.nan, math.nan, math.nan)
    assert_go(frame_checks.air(nothing, False, LIMITS))
    assert_no(frame_checks.air(nothing, True, LIMITS))
    of_controller = frame_checks.air(nothing, True, LIMITS, optional=True)
    assert of_controller.ok
    assert "BME280" in of_controller.remedy
    assert_no(frame_checks.air((60.0, 40.0, 1e5), True, LIMITS))
    dry = PreflightSettings(min_humidity_percent=20, max_humidity_percent=35)
    assert_go(frame_checks.air((20.0, 30.0, 1e5), True, dry))
    assert_no(frame_checks.air((20.0, 40.0, 1e5), True, dry))
    # a band that nobody can see is not met
    assert_no(frame_checks.air((20.0, math.nan, 1e5), True, dry))
    assert_no(frame_checks.air(nothing, True, dry, optional=True))
    assert_go(frame_checks.air((20.0, math.nan, 1e5), True, LIMITS))
    assert_go(frame_checks.controller(opened(), True))
    assert_no(frame_checks.controller(SafetyNow(controller=ControlState.LOST), True))
    assert_go(frame_checks.controller(SafetyNow(), False))


def test_what_stands_against_a_run_is_one_line() -> None:
    bad = frame_checks.disk(1, 5000.0, 500.0, 3600.0)
    assert failures([frame_checks.spot_found(spots(10), LIMITS)]) == ""
    line = failures([bad])
    assert "disk space" in line
    assert bad.remedy in line
