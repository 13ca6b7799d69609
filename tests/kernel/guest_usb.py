"""Runs in the guest: real libusb reads the test camera on the kernel's virtual USB host."""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import libusb_package
import numpy as np
import usb.backend.libusb1

from acquisition.camera import CameraLost, CameraSettings
from acquisition.cameras.drivers import Usb3VisionSettings
from acquisition.cameras.usb3vision import camera as driver
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.cameras.usb3vision.link import find_cameras
from acquisition.cameras.usb3vision.transfers import LibusbTransfers
from tests.acquisition.cameras.aravis.namespace import Missing, python_path
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.acquisition.cameras.usb3vision.usbip import UsbIpServer
from tests.kernel.scenarios import attach, run_scenarios

SUPER_SPEED_PORT, SUPER_SPEED = 8, 5
WIDTH, HEIGHT, RATE_HZ = 320, 240, 20.0


LOOKED_WITH: list[object] = []
"""A library that is let go takes its context with it, and whatever holds a device of that ends in a fault."""


def look_afresh() -> None:
    LOOKED_WITH.append(usb.backend.libusb1._lib_object)
    usb.backend.libusb1._lib = usb.backend.libusb1._lib_object = None


def cameras() -> int:
    """How many cameras libusb finds now.

    libusb hears of new devices from udev's daemon, which the guest has not: it must look afresh.
    """
    look_afresh()
    return len(find_cameras())


def damage(kind: str, block: int, data: bytes) -> list[bytes]:
    """Every part of a frame goes missing or is cut once; the frames are far enough apart to tell."""
    if (kind, block) in {("payload", 5), ("leader", 12), ("trailer", 19)}:
        return []
    return [data[:5000]] if (kind, block) == ("payload", 26) else [data]


def plug_in(unplug_after_bytes: int | None = None, damaged: bool = False) -> int:
    """Attach a camera that lives in a process of its own; returns that process's id."""

    def serve(connection: socket.socket) -> None:
        device = VisionDevice("QEMU-1", frame_rate_hz=RATE_HZ, frames_inside=1000)
        if damaged:
            device.faults.units = damage
        device.faults.unplug_after_stream_bytes = unplug_after_bytes
        signal.signal(signal.SIGUSR1, lambda *_: device.unplug())
        UsbIpServer(device, connection).serve()

    return attach(serve, SUPER_SPEED_PORT, SUPER_SPEED, cameras)


def pull_out(child: int) -> None:
    """End the camera's process, and wait until the kernel has noticed."""
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    deadline_s = time.monotonic() + 10
    while cameras() and time.monotonic() < deadline_s:
        time.sleep(0.1)


def packaged_libusb() -> usb.backend.IBackend:
    """libusb from its package, although this machine has one of its own."""
    look_afresh()
    libusb_package.get_libusb1_backend.cache_clear()
    backend = libusb_package.get_libusb1_backend()
    assert "libusb_package" in backend.lib._name
    return backend


def opened(reading: str, backend: usb.backend.IBackend | None = None) -> Usb3VisionCamera:
    camera = Usb3VisionCamera(Usb3VisionSettings.model_validate({"reading": reading}), backend)
    driver._REPLY_TIMEOUT_S = 2.0  # type: ignore[misc]
    camera.open()
    camera.configure(
        CameraSettings(width_px=WIDTH, height_px=HEIGHT, frame_rate_hz=RATE_HZ, exposure_us=100.0)
    )
    return camera


def frames_are_right(
    reading: str, count: int, damaged: bool = False, packaged: bool = False
) -> dict[str, Any]:
    """Frames in order and byte for byte, or all but those that are damaged."""
    child = plug_in(damaged=damaged)
    camera = opened(reading, packaged_libusb() if packaged else None)
    twin = VisionDevice()
    twin.poke(0x20000, WIDTH.to_bytes(4, "little") + HEIGHT.to_bytes(4, "little"))
    camera.start()
    begin_s = time.monotonic()
    frames = [camera.read(5.0) for _ in range(count)]
    spent_s = time.monotonic() - begin_s
    uses_queue = isinstance(camera._stream and camera._stream._transfers, LibusbTransfers)
    status = camera.status
    stop_s = time.monotonic()
    camera.stop()
    stop_s = time.monotonic() - stop_s
    camera.start()
    again = camera.read(5.0)
    camera.close()
    pull_out(child)
    return {
        "uses_queue": uses_queue,
        "numbers": [frame.sequence for frame in frames if frame],
        "equal": all(frame and np.array_equal(frame.image, twin.pixels(frame.sequence)) for frame in frames),
        "dropped": status.dropped,
        "frames_per_s": count / spent_s,
        "stop_s": stop_s,
        "again": again.sequence if again else None,
    }


def unplugged(reading: str) -> dict[str, Any]:
    """Pulled out in the middle of a frame, noticed, plugged in again, the run goes on."""
    child = plug_in(unplug_after_bytes=10 * (WIDTH * HEIGHT + 84) + 30_000)
    camera = opened(reading)
    camera.start()
    frames, last_s, message = 0, time.monotonic(), ""
    try:
        while True:
            camera.read(5.0)
            frames, last_s = frames + 1, time.monotonic()
    except CameraLost as lost:
        message, noticed_s = str(lost), time.monotonic() - last_s
    camera.close()
    pull_out(child)
    child = plug_in()
    camera.open()
    camera.configure(CameraSettings(width_px=WIDTH, height_px=HEIGHT))
    camera.start()
    frame = camera.read(5.0)
    status = camera.status
    camera.close()
    pull_out(child)
    return {
        "frames": frames,
        "noticed_s": noticed_s,
        "message": message,
        "after": frame.sequence if frame else None,
        "reconnects": status.reconnects,
    }


def aravis_driver() -> dict[str, Any]:
    """The same camera through libaravis, not judged by our own transport alone; and pulled out under it."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            paths = filter(None, [python_path(Path(folder) / "system"), os.getcwd()])
        except Missing as missing:
            return {"skipped": str(missing)}
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
        child = plug_in()
        program = subprocess.Popen(
            [sys.executable, "-m", "tests.kernel.guest_aravis_driver"],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert program.stdout is not None
        first = program.stdout.readline()
        pull_out(child)
        rest, errors = program.communicate(timeout=120)
    if program.returncode:
        return {"skipped" if "needs libaravis" in errors else "error": errors[-2000:]}
    assert first.strip() == "PULL", first
    result: dict[str, Any] = json.loads(rest.strip().splitlines()[-1])
    return result


def main() -> None:
    scenarios: dict[str, Callable[[], dict[str, Any]]] = {
        "queued": lambda: frames_are_right("auto", 60),
        "blocking": lambda: frames_are_right("blocking", 30),
        "packaged": lambda: frames_are_right("auto", 30, packaged=True),
        "damaged_queued": lambda: frames_are_right("auto", 35, damaged=True),
        "damaged_blocking": lambda: frames_are_right("blocking", 35, damaged=True),
        "unplugged_queued": lambda: unplugged("auto"),
        "unplugged_blocking": lambda: unplugged("blocking"),
        "aravis_driver": aravis_driver,
    }
    run_scenarios(scenarios, sys.argv[1:])


if __name__ == "__main__":
    main()
