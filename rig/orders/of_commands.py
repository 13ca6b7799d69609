"""Laser, controller and safety of whoever has the devices, told by its socket; dark by order."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rig.devices import Devices
from rig.orders.server import OrderSocket
from rig.orders.session_news import SessionNews
from rig.settings import Configuration


def devices_now(devices: Devices) -> dict[str, Any]:
    """State of laser, controller and interlock as plain values; never blocks."""
    return {
        "devices": asdict(devices.now()),
        "darkness": devices.darkness(),
        "safety": asdict(devices.safety()),
    }


@contextmanager
def light_told(
    devices: Devices, config: Configuration, folder: Path, session_news: SessionNews | None = None
) -> Iterator[None]:
    """While a command that is no session has the devices: the desk shows its light, and can darken it.

    `folder` is the one that the devices were opened with, which the rig's lock names. A rig without one
    (simulated) is not found by it, and tells nothing, unless it has `session_news` for who knows the folder:
    pictures of what is recorded.
    """
    if devices.state.path is None and session_news is None:
        yield
        return
    with suppress(OSError):
        # without it nobody watches
        folder.mkdir(parents=True, exist_ok=True)
    orders = {"dark": lambda _: devices.light_off("the desk")}
    with OrderSocket(folder, session_news or SessionNews(config), orders, lambda: devices_now(devices)):
        yield
