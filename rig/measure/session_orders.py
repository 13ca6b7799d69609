"""What a person may order while a session runs, at its terminal or through its channel."""

import _thread
import sys
import time
from dataclasses import asdict
from typing import Any

from processing.errors import DeviceError
from rig.channel import Orders, SessionNews
from rig.devices import Devices, wait_for_command

_LOOK_S = 0.1


def orders(devices: Devices) -> Orders:
    """The orders by name; `stop` is Ctrl-C."""

    def stop() -> str:
        _thread.interrupt_main()
        return "stopping: the record is being closed"

    def brake(on: bool) -> str:
        wait_for_command(devices.required_control("the brake").brake(on))
        devices.audit("brake switched", on=on)
        return f"brake {'on' if on else 'off'}"

    return {
        "stop": stop,
        "acknowledge": devices.acknowledge,
        "brake on": lambda: brake(True),
        "brake off": lambda: brake(False),
    }


def devices_now(devices: Devices) -> dict[str, Any]:
    """State of laser, controller and interlock as plain values; never blocks."""
    return {
        "devices": asdict(devices.now()),
        "darkness": devices.darkness(),
        "unacknowledged": devices.permit.unacknowledged,
    }


def acknowledge_interlock(devices: Devices, session_news: SessionNews) -> None:
    """After an interlock has opened, ask whether light is allowed again: at the terminal, else who watches.

    Raises DeviceError without a yes.
    """
    interlock = devices.permit.unacknowledged
    if interlock is None:
        return
    opened = interlock.opened_text
    if sys.stdin.isatty() and sys.stderr.isatty():
        answer = input(f"{opened}. Look that nobody is in the beam's way. Light the laser again? [y/N] ")
        if answer.strip().lower() in {"y", "yes"}:
            devices.acknowledge()
    elif session_news.watched:
        session_news.note("interlock", f"{opened}: the next run waits for an acknowledgement", "error")
        while session_news.watched and devices.permit.unacknowledged:
            time.sleep(_LOOK_S)
    if devices.permit.unacknowledged:
        raise DeviceError(
            f"{opened} and nobody has allowed light again; rig run --resume makes the missing runs"
        )
