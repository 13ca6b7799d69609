"""The commands of `rig light`: a rig's safety state, and its acknowledgement, also while a session runs."""

import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from processing.errors import DeviceError, RigError
from rig.control import SafetyNow, SafetyState, rig_state_path
from rig.devices import AUDIT_NAME, Devices, check_log
from rig.orders import Line, NoSession, running_sessions
from rig.presentation import answer, print_line, say
from rig.settings import Configuration


def show_light(config: Configuration) -> int:
    """Print the safety state; returns 1 where light is refused, else 0."""
    now = _of_a_session(config) or _of_the_devices(config)
    answer(laser=str(now.light), interlock=str(now.interlock), trip=now.trip, refusal=now.refusal)
    answer(laser_age_s=now.light_age_s, interlock_age_s=now.interlock_age_s)
    dark = config.laser.kind == "none"
    deaf = dark and config.controller.kind == "none"
    for name, absent, text, age_s in (
        ("laser", "not controlled by this program" if dark else "", str(now.light), now.light_age_s),
        ("interlock", "not read by this program" if deaf else "", str(now.interlock), now.interlock_age_s),
    ):
        age = f", {age_s:.1f} s ago" if math.isfinite(age_s) else ""
        print_line(f"{name:<10} {absent or text + age}")
    trip = now.trip
    print_line(f"{'trip':<10} {'none is latched' if trip is None else trip.text}")
    if trip is not None:
        print_line(f"{'remedy':<10} check that nobody is in the beam path, then")
        print_line(f"{'':<10} rig light acknowledge {config.named} {trip.number}")
    elif now.refusal:
        print_line(f"{'refused':<10} {now.refusal}")
    return 1 if now.refusal or trip is not None else 0


def acknowledge_trip(config: Configuration, number: int) -> int:
    """Acknowledge a trip, in the session that has the rig or with the devices opened here; lights nothing."""
    for folder in _sessions(config):
        with suppress(NoSession), Line(folder) as line:
            said = line.order(f"acknowledge {number} rig light acknowledge")
            answer(acknowledged=number, said=said)
            say(said)
            return 0
    with Devices(config, config.session.output, "rig light acknowledge") as devices:
        devices.wait_until_heard()
        said = devices.acknowledge(number, "rig light acknowledge")
        answer(acknowledged=number, said=said)
        say(said)
    return 0


def check_audit(folder: Path, config: Configuration | None) -> int:
    """Print what is wrong with an audit log; returns 1 if something is, else 0."""
    state = SafetyState(None if config is None else rig_state_path(config.laser, config.controller))
    state.read()
    faults = check_log(folder, state)
    answer(log=folder / AUDIT_NAME, faults=[str(fault) for fault in faults])
    for fault in faults:
        print_line(f"{folder / AUDIT_NAME}: {fault}")
    if not faults:
        print_line(f"{folder / AUDIT_NAME}: whole")
    return 1 if faults else 0


def _sessions(config: Configuration) -> Iterator[Path]:
    """Folders where a session may run: that of the program which has the rig, and those of the output."""
    held = SafetyState(rig_state_path(config.laser, config.controller)).folder_of_holder
    if held is not None:
        yield held
    yield from running_sessions(config.session.output)


def _of_a_session(config: Configuration) -> SafetyNow | None:
    for folder in _sessions(config):
        with suppress(NoSession, KeyError, ValueError), Line(folder) as line:
            return SafetyNow.told(line.news()["safety"])
    return None


def _of_the_devices(config: Configuration) -> SafetyNow:
    """With the devices opened, which lights nothing; what the file says where another program has them."""
    try:
        with Devices(config, None, "rig light show") as devices:
            devices.wait_until_heard()
            return devices.safety()
    except DeviceError as error:
        say(str(error), error=True)
    state = SafetyState(rig_state_path(config.laser, config.controller))
    with suppress(RigError):
        state.read()
    trip = state.trip
    return SafetyNow(trip, "" if trip is None else trip.text)
