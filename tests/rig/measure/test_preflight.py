"""Each check of the preflight: go and no-go from plain values, with reason and remedy."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from acquisition.camera import Frame
from calibration import Axes, Shutter
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
RAD, PX = DeflectionUnit.RAD, DeflectionUnit.PX
Check = Callable[[], Verdict]


def spots(count: int, *, amplitude_dn: float = 150.0, flags: int = 0) -> list[Spot]:
    return [Spot(1.0, 2.0, 0.01, 0.01, 6.0, 6.0, 0.0, amplitude_dn, 6.0, 1.0, flags)] * count


def frames(
    count: int, rate_hz: float = 100.0, *, jitter_s: float = 0.0, missing: int = 0, faster: float = 1.0
) -> list[Frame]:
    noise = np.random.default_rng(5).normal(0.0, 1.0, (count, 2))
    image = np.zeros((4, 4), np.uint8)
    found = []
    for k in range(count):
        sequence = k if k < count // 2 else k + missing
        device_ns = round(1e9 * (1.0 + sequence / rate_hz + jitter_s * noise[k, 0]))
        host_ns = device_ns + 5_000_000 + abs(round(1e4 * noise[k, 1]))
        found.append(Frame(image, sequence, round(device_ns * faster), host_ns))
    return found


def look(x: float, y: float, unit: DeflectionUnit = RAD) -> TrialFrames:
    """A hundred frames in which the spot stands still."""
    ones = np.ones(100)
    deflections = Deflections(np.arange(100) * 10_000_000, x * ones, y * ones, ones, ones, unit)
    return TrialFrames(frames(100), spots(100), deflections, True)


def minute(y: np.ndarray, unit: DeflectionUnit = RAD) -> TrialFrames:
    """A minute of such a deflection, 25 times a second."""
    times_ns, u = np.arange(1500, dtype=np.int64) * 40_000_000, np.full(1500, 3e-8)
    return replace(look(0.0, 0.0), deflections=Deflections(times_ns, 0 * y, y, u, u, unit))


PHASE = 2 * math.pi * np.arange(1500) * 0.04 / 4.0
NOISE = np.random.default_rng(2).normal(0.0, 3e-8, 1500)
FREE = ARCSEC_RAD * np.sin(PHASE) + NOISE
"""A swing of 1 arcsec that nothing drives."""
_WANDER = 1e-7 * np.cumsum(np.random.default_rng(5).normal(size=(2, 1500)), axis=1)
DRIVEN = _WANDER[0] * np.sin(PHASE) + _WANDER[1] * np.cos(PHASE) + 0.3 * NOISE
"""One that the ground pushes in every period by chance: its quadratures wander."""
SWINGING = TrialFrames([], [], Deflections(*[np.empty(0)] * 5, RAD), False)
NO_AIR = (math.nan, math.nan, math.nan)
DRY = PreflightSettings(min_humidity_percent=20, max_humidity_percent=35)


def asking(ground: float) -> PreflightSettings:
    return PreflightSettings(max_ground_rad_per_s2_rthz=ground)


def shaken(size: float, shake: float, unit: DeflectionUnit = RAD) -> list[Verdict]:
    """Of noise of such a size in four seconds, and a shake at the mains' frequency along y."""
    times_s = np.arange(2000) / 500.0
    noise, u = np.random.default_rng(3).normal(0.0, size, 2000), np.full(2000, size)
    y = noise + shake * np.sin(2 * math.pi * 50.0 * times_s)
    deflections = Deflections(np.rint(1e9 * times_s).astype(np.int64), 0.1 * noise, y, 0.1 * u, u, unit)
    return rest_checks.stillness(TrialFrames([], [], deflections, True), LIMITS)


def at_rest(noise_arcsec: float, shake_arcsec: float, which: int) -> Verdict:
    return shaken(noise_arcsec * ARCSEC_RAD, shake_arcsec * ARCSEC_RAD)[which]


def peak(amplitude_dn: float) -> Check:
    return lambda: frame_checks.exposure(spots(50, amplitude_dn=amplitude_dn), 255.0, LIMITS)


def clock(found: list[Frame]) -> Check:
    return lambda: frame_checks.clock(found, LIMITS)


def air(*values: float, limits: PreflightSettings = LIMITS, optional: bool = False) -> Check:
    return lambda: frame_checks.air(values, True, limits, optional=optional)  # type: ignore[arg-type]


GO: dict[str, Check] = {
    "spot": lambda: frame_checks.spot_found(spots(995) + spots(5, flags=SpotFlag.LOST), LIMITS),
    "peak at a quarter": peak(60.0),
    "peak at eight tenths": peak(200.0),
    "no pixel at full scale": lambda: frame_checks.saturation(spots(100), LIMITS),
    "noise": lambda: at_rest(0.01, 0.0, 0),
    "vibration": lambda: at_rest(0.01, 0.0, 1),
    # nothing drives it: it is quiet enough for any limit
    "ground that is still": lambda: rest_checks.ground(minute(FREE), asking(1e-9)),
    "ground within its limit": lambda: rest_checks.ground(minute(DRIVEN), asking(1.0)),
    "rest position": lambda: rest_checks.rest_position(look(3e-8, 20 * ARCSEC_RAD), LIMITS),
    "clock": clock(frames(200)),
    "no clock": clock([frame._replace(device_time_ns=-1) for frame in frames(200)]),
    "frame rate": lambda: frame_checks.frame_rate(frames(500), 100.0, LIMITS),
    "disk": lambda: frame_checks.disk(10**10, 5000.0, 500.0, 3600.0),
    "no sensor of the air": lambda: frame_checks.air(NO_AIR, False, LIMITS),
    "humidity within its band": air(20.0, 30.0, 1e5, limits=DRY),
    "humidity that nobody asks for": air(20.0, math.nan, 1e5),
    "controller": lambda: frame_checks.controller(opened(), True),
    "no controller": lambda: frame_checks.controller(SafetyNow(), False),
    "laser": lambda: frame_checks.laser(LaserReport(Light.ON, 0.5e-3), True),
    "no laser": lambda: frame_checks.laser(None, True),
}
NO_GO: dict[str, tuple[Check, str]] = {
    "spot": (
        lambda: frame_checks.spot_found(spots(98) + spots(2, flags=SpotFlag.LOST), LIMITS),
        "98.0 % of 100 frames",
    ),
    "no frame": (lambda: frame_checks.spot_found([], LIMITS), "0.0 % of 0"),
    "too dark": (peak(10.0), "peak 6 %"),
    "too bright": (peak(245.0), "lower the exposure"),
    "pixels at full scale": (
        lambda: frame_checks.saturation(spots(50, flags=SpotFlag.SATURATED) + spots(50), LIMITS),
        "50.0 % of frames",
    ),
    "noise": (lambda: at_rest(0.5, 0.0, 0), "0.4909 arcsec a frame"),
    "vibration": (lambda: at_rest(0.01, 0.5, 1), "50.0 Hz (mains"),
    "ground": (lambda: rest_checks.ground(minute(DRIVEN), asking(1e-9)), "quieter hour"),
    "ground unknown": (lambda: rest_checks.ground(look(0.0, 0.0), asking(1e-9)), "preflight.duration_s"),
    "rest position": (
        lambda: rest_checks.rest_position(look(3e-8, 70 * ARCSEC_RAD), LIMITS),
        "Y +70.0 arcsec",
    ),
    "clock that jitters": (clock(frames(200, jitter_s=5e-4)), "come unevenly"),
    "too few frames for a clock": (clock(frames(10)), "not measured"),
    # a register in ticks taken for nanoseconds, for example
    **{f"clock {rate} times as fast": (clock(frames(400, faster=float(rate))), rate[:4])
       for rate in ("8", "125", "1.002", "0.5")},
    "frame rate": (lambda: frame_checks.frame_rate(frames(500, 80.0), 100.0, LIMITS), "80.00 Hz"),
    "losses": (lambda: frame_checks.frame_rate(frames(500, missing=10), 100.0, LIMITS), "1.96 % lost"),
    "disk": (lambda: frame_checks.disk(10**9, 5000.0, 500.0, 3600.0), "9.0 GB for 3600 s"),
    "disk nearly full": (lambda: frame_checks.disk(12_000, 5000.0, 50.0, 14.0), "3.5 MB for 14 s"),
    "silent sensor": (air(*NO_AIR), "the sensor is silent"),
    "hot": (air(60.0, 40.0, 1e5), "60.0 °C"),
    "damp": (air(20.0, 40.0, 1e5, limits=DRY), "40 %"),
    # a band that nobody can see is not met
    "humidity not reported": (air(20.0, math.nan, 1e5, limits=DRY), "humidity"),
    "no reading for a band": (air(*NO_AIR, limits=DRY, optional=True), "silent"),
    "controller": (
        lambda: frame_checks.controller(SafetyNow(controller=ControlState.LOST), True),
        "rig doctor",
    ),
    "laser": (lambda: frame_checks.laser(LaserReport(Light.OFF), True), "rig doctor"),
}  # fmt: skip


@pytest.mark.parametrize("name", GO)
def test_go_says_nothing_against_it_and_nothing_to_do(name: str) -> None:
    verdict = GO[name]()
    assert (verdict.ok, verdict.reason, verdict.remedy) == (True, "", "")


@pytest.mark.parametrize("name", NO_GO)
def test_no_go_says_why_and_what_to_do(name: str) -> None:
    check, said = NO_GO[name]
    verdict = check()
    assert not verdict.ok
    assert verdict.made
    assert verdict.reason
    assert verdict.remedy
    assert said in f"{verdict.measured} {verdict.limit} {verdict.reason} {verdict.remedy}"


def test_the_disk_is_judged_by_the_rate_of_all_frames_not_of_the_whole_ones_that_memory_holds() -> None:
    """Of a large sensor only the newest frames are held whole: a fifth of them needed a fifth of the disk."""
    stated = {"camera": {"driver": "simulated"}, "session": {"max_duration_s": 1e4}}
    config = Configuration.model_validate(stated)
    whole = look(0.0, 0.0)
    for frames_held in (100, 20):
        held = replace(whole, frames=whole.frames[-frames_held:], resting=False)
        verdicts = frame_checks.check_trial_frames(held, config, 255.0, 1000.0, 10**12)
        (limit,) = [verdict.limit for verdict in verdicts if verdict.name == "disk space"]
        assert limit == "1.3 GB for 10000 s", f"{frames_held} frames"


def test_a_swinging_pendulum_has_no_noise_floor_and_that_is_no_fault() -> None:
    verdicts = [*rest_checks.stillness(SWINGING, LIMITS), rest_checks.ground(SWINGING, LIMITS)]
    assert len(verdicts) == 3
    assert all(v.ok and not v.made and v.measured == "not measured" and v.reason for v in verdicts)


def test_a_resting_spot_seen_too_seldom_is_no_go() -> None:
    """Below 25 frames/s four seconds were too short, and that passed as go."""
    few = replace(look(0.0, 0.0), deflections=look(0.0, 0.0).deflections[:80])
    for verdict in rest_checks.stillness(few, LIMITS):
        assert (verdict.ok, verdict.made) == (False, True)
        assert verdict.reason
        assert verdict.remedy


def test_what_was_not_checked_and_what_is_a_warning_is_not_called_go() -> None:
    verdicts = [
        *rest_checks.stillness(SWINGING, LIMITS),
        frame_checks.spot_found(spots(100), LIMITS),
        frame_checks.laser(LaserReport(Light.ON, 0.5e-3), goes_dark_by_itself=False),
        frame_checks.disk(1, 5000.0, 500.0, 3600.0),
    ]
    text = StringIO()
    print_verdicts(Console(file=text, width=100), verdicts)
    lines = text.getvalue().splitlines()
    marks = ("-", "-", "go", "warn", "NO")
    for verdict, mark in zip(verdicts, marks, strict=True):
        assert next(line for line in lines if verdict.name in line[:24]).split()[0] == mark, verdict.name
    assert "not checked: noise floor, vibration: the pendulum may be swinging" in text.getvalue()
    # lit, and only this program switches it off
    laser = verdicts[3]
    assert laser.ok
    assert "killed" in laser.reason
    assert "relay" in laser.remedy
    # what stands against a run is one line
    line = failures(verdicts)
    assert "disk space" in line
    assert verdicts[-1].remedy in line
    assert "laser" not in line
    assert failures(verdicts[:-1]) == ""


def test_the_ground_is_said_once_the_look_is_long_enough() -> None:
    short, long = (rest_checks.ground(trial, LIMITS) for trial in (look(3e-8, 0.0), minute(FREE)))
    assert (short.ok, short.made, long.made) == (True, False, True)
    assert "preflight.duration_s" in short.reason
    assert long.measured.startswith("below ")
    assert long.measured.endswith("in 60 s")
    assert rest_checks.ground(minute(DRIVEN), asking(1e-9)).limit == "1e-09 rad/s²/√Hz"
    in_px = rest_checks.ground(minute(DRIVEN, PX), asking(1e-9))
    assert (in_px.ok, in_px.reason, in_px.remedy) == (True, rest_checks.NO_LEVER, "")


@pytest.mark.parametrize("size_px", [0.0001, 10.0])
def test_px_are_called_px_and_not_held_against_limits_in_arcsec(size_px: float) -> None:
    """Values that would be go, and values that would be no-go, if their px were taken for arcsec."""
    verdicts = [
        *shaken(size_px, 50.0 * size_px, PX),
        rest_checks.rest_position(look(size_px, 70 * size_px, PX), LIMITS),
    ]
    for verdict in verdicts:
        assert " px" in verdict.measured
        assert "arcsec" not in verdict.measured
        assert (verdict.ok, verdict.made, verdict.remedy) == (True, False, "")
        assert verdict.reason.startswith("no lever")


def test_a_clock_whose_rate_cannot_be_judged_is_unknown_and_not_go() -> None:
    """Frames that a busy computer read all at once, or seconds late; and frames made on demand."""
    late_ns = np.cumsum(np.rint(2e8 * np.random.default_rng(3).standard_normal(60) ** 2)).astype(int) // 2
    late = [
        frame._replace(host_time_ns=frame.host_time_ns + int(ns))
        for frame, ns in zip(frames(60), late_ns, strict=True)
    ]
    verdict = frame_checks.clock(late, LIMITS)
    assert (verdict.ok, verdict.made) == (True, False)
    assert "rate unknown" in verdict.measured
    assert verdict.reason.startswith("unknown: ")
    assert "go" not in verdict.judgement_text.split(",")[0]
    made = frame_checks.clock(frames(400, faster=8.0), LIMITS, on_demand=True)
    assert "times as fast as the computer's" not in made.reason
    assert "ppm" not in made.measured


def test_a_rolling_shutter_is_advised_where_it_matters() -> None:
    across, along = Axes(slow_angle_rad=0.02), Axes(slow_angle_rad=math.pi / 2 - 0.05)
    rolling = partial(frame_checks.shutter, "Rolling")
    for axes in (None, across):
        advised = rolling(None, axes)
        assert advised.ok
        assert "row time unknown" in advised.measured
        assert "turn the camera" in advised.remedy
    known = rolling(Shutter(row_time_s=1.5e-5, u_row_time_s=2e-7), across)
    assert "15.00 ± 0.20 µs a row" in known.measured
    for fine in (known, rolling(None, along), frame_checks.shutter("GlobalReset", None, across)):
        assert not fine.remedy
    assert not frame_checks.shutter("", None, across).made


def test_a_controller_without_a_sensor_of_the_air_may_run() -> None:
    verdict = air(*NO_AIR, optional=True)()
    assert verdict.ok
    assert "BME280" in verdict.remedy
