"""Runs in the guest: the Thorlabs driver talks to an instrument through the kernel's usbtmc."""

import os
import signal
import socket
import subprocess
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from processing.errors import DeviceError
from rig.control.lasers import LaserSettings
from rig.control.lasers.thorlabs4000 import Thorlabs4000
from tests.kernel.scenarios import attach, run_scenarios
from tests.kernel.usbtmc_device import UsbTmcDevice
from tests.rig.control.instruments import FakeThorlabs

HIGH_SPEED_PORT, HIGH_SPEED = 0, 3
SERIAL = "M00277475"


def plug_in() -> int:
    """Attach an instrument that lives in a process of its own; SIGUSR1 makes it silent, or speak again."""

    def serve(connection: socket.socket) -> None:
        instrument = FakeThorlabs()

        def mute(*_: object) -> None:
            instrument.silent = not instrument.silent

        def answer(command: str) -> str | None:
            reply = instrument.answer(command)
            return None if instrument.silent else reply

        signal.signal(signal.SIGUSR1, mute)
        UsbTmcDevice(connection, SERIAL, answer).serve()

    return attach(serve, HIGH_SPEED_PORT, HIGH_SPEED, lambda: list(Path("/dev").glob("usbtmc*")))


def driver(port: str = "usbtmc") -> Thorlabs4000:
    return Thorlabs4000(
        LaserSettings(kind="thorlabs4000", port=port, max_current_a=0.03, current_a=0.02, timeout_s=0.5)
    )


def refusal(port: str) -> str:
    try:
        driver(port).open()
    except DeviceError as error:
        return str(error)
    return "opened"


def talk() -> dict[str, Any]:
    """Found, opened, lit, dark; silent for a while; pulled out."""
    found: dict[str, Any] = {"missing": refusal("usbtmc")}
    child = plug_in()
    laser = driver()
    found["identity"] = list(asdict(laser.open()).values())
    found["second"] = refusal("/dev/usbtmc0")
    found["other"] = refusal("usbtmc:M1")
    laser.set_current_a(0.02)
    laser.enable()
    found["lit"] = asdict(laser.state())
    os.kill(child, signal.SIGUSR1)
    begin_s = time.monotonic()
    try:
        laser.state()
    except DeviceError as error:
        found["silent"] = str(error)
    found["silent_s"] = time.monotonic() - begin_s
    os.kill(child, signal.SIGUSR1)
    laser.off()
    found["dark"] = asdict(laser.state())
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    try:
        while True:
            laser.state()
    except DeviceError as error:
        found["pulled"] = str(error)
    return found


def main() -> None:
    os.makedirs("/dev/pts", exist_ok=True)
    subprocess.run(["mount", "-t", "devpts", "devpts", "/dev/pts"], check=True)
    run_scenarios({"talk": talk}, ())


if __name__ == "__main__":
    main()
