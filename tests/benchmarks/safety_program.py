"""One path to light in a process of its own; words: path, configuration, folder, and a fault if wanted.

The path is a command of `rig`. A fault of the program itself begins with SIGUSR1.
"""

import errno
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

from acquisition.cameras.simulated import SimulatedCamera
from acquisition.record.writer import RecordWriter
from acquisition.simulation.inputs import RigInputs
from processing.errors import DeviceError
from rig.cli import main
from rig.control import LightRefused
from rig.control.service import ControlService
from rig.devices import Devices, session_devices
from rig.devices.frame_stream import FrameStream
from rig.interruption import terminated_by_signals
from rig.measure import record_plainly
from rig.settings import load_configuration

PLACES: dict[str, tuple[type, str]] = {
    "camera stalls": (SimulatedCamera, "read"),
    "processing hangs": (FrameStream, "take"),
    "disk full": (RecordWriter, "write_spots"),
    "disk hangs": (RecordWriter, "write_spots"),
    "control thread hangs": (ControlService, "_poll"),
    "control thread dies": (ControlService, "_poll"),
    "processing dies": (FrameStream, "take"),
    "camera fails": (SimulatedCamera, "read"),
}
"""Where the program's own faults are: the method that hangs or fails from SIGUSR1 on."""


def _spoil(fault: str) -> None:
    kind, name = PLACES[fault]
    begun = threading.Event()
    signal.signal(signal.SIGUSR1, lambda *_: begun.set())
    usual: Callable[..., Any] = getattr(kind, name)

    def spoiled(*words: Any, **named: Any) -> Any:
        if begun.is_set():
            if fault == "disk full":
                raise OSError(errno.ENOSPC, "No space left on device")
            if fault == "camera fails":
                raise DeviceError("the camera is gone")
            if fault.endswith("dies"):
                raise RuntimeError("a fault of the program")
            time.sleep(60.0)
        return usual(*words, **named)

    setattr(kind, name, spoiled)


def _light_as_the_board_says(log: Path) -> None:
    """The simulated camera sees the laser that the board switches, which is none of the simulated rig's."""
    inputs = RigInputs()
    inputs.laser(0.0)

    def follow() -> None:
        with log.open() as lines:
            while True:
                words = lines.readline().split()
                if not words:
                    time.sleep(0.005)
                elif words[1] == "laser":
                    inputs.laser(float(words[3]) if words[2] == "1" else 0.0)

    threading.Thread(target=follow, daemon=True).start()
    patch.object(
        session_devices,
        "make_camera",
        lambda config: SimulatedCamera(config.simulation, config.faults, inputs),
    ).start()


def _ask(config: Path) -> None:
    """What another program gets that asks for light, without and with a person's acknowledgement."""
    with Devices(load_configuration(config), task="the benchmark") as devices:
        deadline_s = time.monotonic() + 2.0
        while devices.permit.latched is None and time.monotonic() < deadline_s:
            time.sleep(0.05)
        try:
            devices.light()
            print("LIT", flush=True)
        except DeviceError as refused:
            latched = devices.permit.latched
            print(f"REFUSED {'' if latched is None else latched.text} | {refused}", flush=True)
            if latched is None:
                return
            time.sleep(0.5)
            print("ACKNOWLEDGED", flush=True)
            devices.acknowledge(latched.number, "the benchmark")
            try:
                devices.light(on_request=True)
                print("LIT", flush=True)
            except LightRefused as still:
                print(f"STILL {still}", flush=True)


def begin(path: str, config: Path, folder: Path, fault: str) -> None:
    """Take the path until it ends."""
    # which a shell's background job ignores
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if fault:
        _spoil(fault)
    _light_as_the_board_says(config.with_name("outputs.log"))
    words = {
        "run": ["run", str(config), "-o", str(folder)],
        "resume": ["run", "--resume", str(folder)],
        "balance": ["balance", str(config), "--follow", "3"],
        "preflight": ["doctor", str(config), "--preflight"],
        "doctor": ["doctor", str(config)],
        "align": ["camera", "align", str(config)],
    }.get(path)
    if words is not None:
        sys.argv = ["rig", *words]
        main()
        return
    with terminated_by_signals():
        if path == "ask":
            _ask(config)
        else:
            record_plainly(load_configuration(config), config, folder / "calibration.mcap", 60.0)


if __name__ == "__main__":
    begin(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4] if len(sys.argv) > 4 else "")
