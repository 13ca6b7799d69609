"""What a person may order while a session runs, at its terminal or through its channel."""

import _thread
import time
from dataclasses import asdict
from typing import Any

from processing.errors import DeviceError, RigError
from rig.channel import Orders, SessionNews
from rig.control import LightRefused
from rig.devices import Audited, Devices, ask_leave, at_terminal, wait_for_command

_LOOK_S = 0.1


def orders(devices: Devices) -> Orders:
    """The orders by name; `stop` is Ctrl-C, `acknowledge` is followed by the trip's number and by whom."""

    def stop(_: str) -> str:
        _thread.interrupt_main()
        return "stopping: the record is being closed"

    def brake(value: str) -> str:
        if value not in ("on", "off"):
            raise RigError(f"brake {value!r}: should be on or off")
        wait_for_command(devices.required_control("the brake").brake(value == "on"))
        devices.audit(Audited.BRAKE, "ordered", on=value == "on")
        return f"brake {value}"

    def acknowledge(value: str) -> str:
        number, _, by = value.partition(" ")
        if not number.isdecimal():
            raise RigError(f"acknowledge {value!r}: the number of the trip is needed")
        return devices.acknowledge(int(number), by or "desk")

    return {"stop": stop, "acknowledge": acknowledge, "light": lambda _: relight(devices), "brake": brake}


def relight(devices: Devices) -> str:
    """Light the laser of a run again that waits in the dark, because a person asks for it."""
    if not devices.permit.begun:
        raise DeviceError("no run waits for its light: nothing is lit while no frames are processed")
    return devices.light() or "the laser is lit already"


def devices_now(devices: Devices) -> dict[str, Any]:
    """State of laser, controller and interlock as plain values; never blocks."""
    return {
        "devices": asdict(devices.now()),
        "darkness": devices.darkness(),
        "safety": asdict(devices.safety()),
    }


def await_leave(devices: Devices, session_news: SessionNews) -> None:
    """After a trip wait until a person has acknowledged it: at the terminal, else who watches.

    The laser of the next run is lit then. Raises LightRefused if nobody acknowledges it.
    """
    ask_leave(devices)
    trip = devices.permit.latched
    if trip is not None and session_news.watched and not at_terminal():
        session_news.note("interlock", f"{trip.text}: the next run waits for an acknowledgement", "error")
        while session_news.watched and devices.permit.latched:
            time.sleep(_LOOK_S)
    if trip := devices.permit.latched:
        raise LightRefused(
            f"{trip.text}, and nobody has acknowledged it; rig run --resume makes the missing runs"
        )
