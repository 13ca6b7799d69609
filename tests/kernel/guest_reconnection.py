"""Runs in the guest: vivid's camera goes and comes back while a stream at default settings reads it.

What is done to it: its driver is unbound and bound, as when a cable is pulled and plugged in; its module is
unloaded and loaded; its device is given another number, because another program still holds the old one.
The argument is the file of vivid's module; names of scenarios may follow.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from acquisition.camera import CameraSettings, Frame
from acquisition.cameras.drivers import V4l2Settings
from acquisition.cameras.v4l2 import kernel
from acquisition.cameras.v4l2.camera import V4l2Camera
from acquisition.cameras.v4l2.devices import list_devices
from rig.devices.frame_stream import FrameStream
from tests.kernel.scenarios import run_scenarios

DRIVER = Path("/sys/bus/platform/drivers/vivid")
ASKED = CameraSettings(width_px=320, height_px=180, frame_rate_hz=30.0)
WITHIN_S = 120.0
AWAY_S = 1.0


class Run:
    """A stream at default settings, and what came out of it."""

    def __init__(self, asked: CameraSettings = ASKED, **options: str) -> None:
        self.camera = V4l2Camera(V4l2Settings.model_validate(options))
        self.camera.open()
        self.stream = FrameStream(self.camera, asked, applied=self.camera.configure(asked))
        self.stream.start_camera()
        assert self.stream.begin() is not None
        self.frames: list[Frame] = []
        self.events: list[tuple[str, str]] = []

    def said(self, kind: str) -> bool:
        return kind in [name for name, _ in self.events]

    def until(self, reached: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + WITHIN_S
        while not reached():
            if time.monotonic() > deadline_s or self.stream.drained:
                raise AssertionError((self.events, self.stream.ended, len(self.frames)))
            self.frames += self.stream.take(64, 0.1)
            self.events += [(str(kind), text) for kind, text in self.stream.take_events()]

    def goes_and_comes(self, go: Callable[[], None], come: Callable[[], None]) -> dict[str, Any]:
        """What the stream made of a camera that was away for a second."""
        try:
            self.until(lambda: len(self.frames) > 20)
            go()
            self.until(lambda: self.said("camera lost"))
            before = len(self.frames)
            away_s = time.monotonic() + AWAY_S
            self.until(lambda: time.monotonic() > away_s)
            come()
            self.until(lambda: self.said("camera back") and len(self.frames) > before + 20)
        finally:
            self.stream.close()
            reconnects = self.camera.status.reconnects
            self.camera.close()
        return {
            "failure": repr(self.stream.failure) if self.stream.failure else "",
            "events": self.events,
            "numbers": [frame.sequence for frame in self.frames],
            "device_time_ns": [frame.device_time_ns for frame in self.frames],
            "host_time_ns": [frame.host_time_ns for frame in self.frames],
            "images": sorted({(*frame.image.shape, str(frame.image.dtype)) for frame in self.frames}),
            "while_unplugged": self.stream.losses.while_unplugged,
            "lost": self.stream.losses.total,
            "reconnects": reconnects,
        }


def path() -> str:
    return next(found.path for found in list_devices() if "vivid" in found.name and "GREY" in found.formats)


def unbind() -> None:
    (DRIVER / "unbind").write_text("vivid.0")


def bind() -> None:
    (DRIVER / "bind").write_text("vivid.0")


def unload() -> None:
    done = busybox("rmmod", "vivid")
    assert not done.returncode, done.stderr


def load() -> None:
    done = busybox("insmod", sys.argv[1])
    assert not done.returncode, done.stderr


def busybox(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["busybox", *words], capture_output=True, text=True, check=False)


def cable() -> dict[str, Any]:
    return Run().goes_and_comes(unbind, bind)


def settings() -> dict[str, Any]:
    """Nothing is asked for: the format that another program has set is that of the whole run."""
    handle = kernel.open_device(path())
    kernel.set_layout(handle, 640, 360, "Y12 ")
    kernel.set_rate_hz(handle, 25.0)
    os.close(handle)
    return Run(CameraSettings()).goes_and_comes(unbind, bind)


def module() -> dict[str, Any]:
    def come() -> None:
        unload()
        load()

    # a module in use is not unloaded: its device goes first
    return Run().goes_and_comes(unbind, come)


def other_number() -> dict[str, Any]:
    """The configuration names the device, whose number is then taken by a program that holds the old one."""
    before = path()
    run = Run(device=before)
    held = os.open(before, os.O_RDWR | os.O_NONBLOCK)
    try:
        return {**run.goes_and_comes(unbind, bind), "before": before, "after": path()}
    finally:
        os.close(held)


def main() -> None:
    scenarios = {
        "cable": cable,
        "settings": settings,
        "module": module,
        "other_number": other_number,
    }
    run_scenarios(scenarios, sys.argv[2:])


if __name__ == "__main__":
    main()
