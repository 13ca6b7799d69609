"""Work on the rig without a session: a plain record, a preflight, frames, light, trips."""

import math
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from pydantic import BaseModel
from rich.console import Console

from acquisition import atomic_write
from processing.errors import ConfigurationError, DeviceError, RecordError, RigError
from rig.control import Light, SafetyNow, SafetyState, rig_state_path
from rig.devices import (
    ORDERS_NAME,
    SWITCHED_BY_HAND,
    Devices,
    LightOff,
    NoSession,
    OrderConnection,
    SessionNews,
    ask_acknowledgement,
    light_shown_to_desk,
    png_of,
    read_frames,
    running_sessions,
)
from rig.instrument import check_materials, complete
from rig.measure.run import measure_run
from rig.measure.run_parts import RunPlan, ready_for_frames
from rig.settings import Configuration
from rig.terminal import Verdict, answer, failures, print_json_line, print_line, print_verdicts, say

_MAX_CONFIRMATION_S = 3.0
"""Longest wait until a session has heard from its devices that they are dark."""
_LOOK_INTERVAL_S = 0.05
_DARK = (Light.OFF, Light.INTERLOCK_OPEN)
_UNREACHED_ARCSEC = 1e-9
"""Final amplitude in arcsec that no record reaches, not even that of a clamped pendulum."""


def record_plainly(config: Configuration, source: Path, record: Path, seconds: float | None = None) -> int:
    """Record one run without viewer and fits; returns the exit status 0.

    With `seconds` the spot is recorded for that time, moving or not: no preflight, no start.
    The order socket of the folder shows the picture meanwhile. The record ends if the laser goes dark.

    Raises RigError if the recording fails, KeyboardInterrupt after Ctrl-C, which leaves a closed record.
    """
    updates: dict[str, BaseModel] = {"view": config.view.model_copy(update={"mode": "none"})}
    if seconds is not None:
        limits = {"max_duration_s": seconds, "final_amplitude_arcsec": _UNREACHED_ARCSEC, "stop_when": ()}
        updates |= {
            "session": config.session.model_copy(update=limits),
            "preflight": config.preflight.model_copy(update={"when": "never"}),
            "start": config.start.model_copy(update={"way": "at once"}),
            # a person who only looks at the picture acknowledges no trip
            "laser": config.laser.model_copy(update={"when_dark": "end"}),
        }
    record.parent.mkdir(parents=True, exist_ok=True)
    config = complete(config.model_copy(update=updates))
    folder, session_news = record.parent, SessionNews()
    with (
        ready_for_frames(live=not config.on_demand),
        Devices(config, folder, "a record alone") as devices,
        light_shown_to_desk(devices, folder, session_news),
    ):
        ask_acknowledgement(devices)
        fitted = bool(config.session.stop_when)
        plan = RunPlan(config, source, record, record.stem, fitted=fitted, session_news=session_news)
        outcome = measure_run(plan, devices)
    outcome.check()
    answer(written=[record])
    print(record)
    return 0


def take_frames(config: Configuration, folder: Path, count: int) -> Path:
    """Save whole frames as PNG, with every bit, into a new folder; the laser stays as it is.

    Raises ConfigurationError for a folder that exists, DataError if the camera gives too few frames.
    """
    if folder.exists():
        raise ConfigurationError(f"{folder}: exists already and is not overwritten; choose another folder")
    with Devices(config).camera(config) as opened:
        frames = read_frames(opened.camera, count, config.camera.patience_s)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write.atomic_folder(folder) as unfinished:
            for number, frame in enumerate(frames):
                name = f"{number:03d}.png"
                (unfinished / name).write_bytes(png_of(frame.image, folder / name))
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return folder


def preflight_rig(config: Configuration, *, json_lines: bool = False) -> int:
    """Light the laser, look at the spot, print the table of checks; returns exit status 1 for no-go.

    Nothing is moved and nothing is recorded. Noise, rest position and ground are judged if a run would begin
    at rest (start.way is not 'at once'): the pendulum must rest then.
    """
    preflight = config.preflight.model_copy(update={"when": "always"})
    quiet = config.view.model_copy(update={"mode": "none"})
    config = complete(config.model_copy(update={"preflight": preflight, "view": quiet}))
    check_materials(config)
    folder, verdicts = config.session.output, list[Verdict]()
    with (
        ready_for_frames(live=not config.on_demand),
        Devices(config, folder, "rig doctor --preflight") as devices,
        light_shown_to_desk(devices, folder),
    ):
        ask_acknowledgement(devices)
        # whose free disk is checked
        existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        plan = RunPlan(
            config,
            Path(),
            existing / "preflight",
            "preflight",
            json_lines=json_lines,
            fitted=False,
            checked=verdicts.extend,
        )
        outcome = measure_run(plan, devices)
    outcome.check()
    if json_lines:
        print_json_line("preflight", {"table": verdicts})
    else:
        print_verdicts(Console(), verdicts)
    if failed_checks := failures(verdicts):
        say(f"no-go: {failed_checks}")
    return 1 if failed_checks or not verdicts else 0


def show_light(config: Configuration) -> int:
    """Print the safety state; returns 1 where light is refused, else 0."""
    now = _session_state(config) or _device_state(config)
    _print_state(config, now)
    return 1 if now.refusal or now.trip is not None else 0


def _print_state(config: Configuration, now: SafetyNow) -> None:
    answer(laser=str(now.light), interlock=str(now.interlock), trip=now.trip, refusal=now.refusal)
    answer(laser_age_s=now.light_age_s, interlock_age_s=now.interlock_age_s)
    has_laser = config.laser.kind != "none"
    reads_interlock = has_laser or config.controller.kind != "none"
    for name, is_read, text, age_s, absence in (
        ("laser", has_laser, str(now.light), now.light_age_s, "not controlled by this program"),
        ("interlock", reads_interlock, str(now.interlock), now.interlock_age_s, "not read by this program"),
    ):
        age = f", {age_s:.1f} s ago" if math.isfinite(age_s) else ""
        print_line(f"{name:<10} {text + age if is_read else absence}")
    trip = now.trip
    print_line(f"{'trip':<10} {'none is latched' if trip is None else trip.text}")
    if trip is not None:
        print_line(f"{'remedy':<10} check that nobody is in the beam path, then")
        print_line(f"{'':<10} rig light acknowledge {config.command_words} {trip.number}")
    elif now.refusal:
        print_line(f"{'refused':<10} {now.refusal}")


def light_off(config: Configuration) -> int:
    """LIGHT OFF from a terminal: everything dark, until a person acknowledges it; prints the state then.

    Returns 1 where something failed, or where no device has confirmed that the light is off.
    """
    rig = SafetyState(rig_state_path(config.laser, config.controller))
    sessions = [path.parent for path in config.session.output.glob(f"*/{ORDERS_NAME}")]
    problems, heard, _ = LightOff(config, rig, "a terminal", sessions).result()
    if config.laser.kind == "none":
        problems.append(SWITCHED_BY_HAND)
    elif rig.presses is None and not heard:
        problems.append(f"no session of this simulated rig runs in {config.session.output}")
    for problem in problems:
        say(problem, error=True)
    now, deadline_s = _session_state(config), time.monotonic() + _MAX_CONFIRMATION_S
    while now is not None and now.light not in _DARK and time.monotonic() < deadline_s:
        time.sleep(_LOOK_INTERVAL_S)
        now = _session_state(config)
    now = now or _device_state(config)
    _print_state(config, now)
    return 0 if now.light in _DARK and not problems else 1


def acknowledge_trip(config: Configuration, number: int) -> int:
    """Acknowledge a trip, in the session that runs or with the devices opened here; lights nothing."""
    command, reply = "rig light acknowledge", ""
    for folder in _sessions(config):
        with suppress(NoSession), OrderConnection(folder) as connection:
            reply = connection.order(f"acknowledge {number} {command}")
            break
    else:
        with Devices(config, config.session.output, command) as devices:
            devices.wait_for_reports()
            reply = devices.acknowledge(number, command)
    answer(acknowledged=number, said=reply)
    say(reply)
    return 0


def _sessions(config: Configuration) -> Iterator[Path]:
    """Folders in which a session may run: the folder of the program that holds the rig first."""
    holder_folder = SafetyState(rig_state_path(config.laser, config.controller)).holder_folder
    if holder_folder is not None:
        yield holder_folder
    yield from running_sessions(config.session.output)


def _session_state(config: Configuration) -> SafetyNow | None:
    for folder in _sessions(config):
        with suppress(NoSession, KeyError, ValueError), OrderConnection(folder) as connection:
            return SafetyNow.from_news(connection.news()["safety"])
    return None


def _device_state(config: Configuration) -> SafetyNow:
    """The state read from the devices, unlit; from the state file if another program has them."""
    try:
        with Devices(config, None, "rig light show") as devices:
            devices.wait_for_reports()
            return devices.safety()
    except DeviceError as error:
        say(str(error), error=True)
    state = SafetyState(rig_state_path(config.laser, config.controller))
    with suppress(RigError):
        state.read()
    trip = state.trip
    return SafetyNow(trip, "" if trip is None else trip.text)
