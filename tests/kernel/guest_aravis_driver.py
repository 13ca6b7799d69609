"""Runs in the guest with PyGObject: the aravis driver reads the USB camera."""

import json
import sys
from itertools import pairwise
from typing import Any

from acquisition.camera import CameraLost, CameraSettings, FrameTimeout
from acquisition.cameras.aravis.camera import AravisCamera
from processing.errors import DeviceError
from tests.acquisition.cameras.usb3vision.device import VisionDevice

WIDTH, HEIGHT = 320, 240


def main() -> None:
    camera = AravisCamera()
    try:
        info = camera.open()
    except DeviceError as missing:
        sys.exit(str(missing))
    applied = camera.configure(CameraSettings(width_px=WIDTH, height_px=HEIGHT, exposure_us=200.0))
    twin = VisionDevice()
    twin.poke(0x20000, WIDTH.to_bytes(4, "little") + HEIGHT.to_bytes(4, "little"))
    said: dict[str, Any] = {"serial": info.serial, "exposure_us": applied.exposure_us, "starts": []}
    for again in (True, False):
        camera.start()
        frames = [frame for frame in (camera.read(60.0) for _ in range(20)) if frame]
        status = camera.status
        if again:
            camera.stop()
        said["starts"].append(
            {
                "numbers": [frame.sequence for frame in frames],
                "blocks": [twin.block_of(frame.image) for frame in frames],
                "times_rise": all(a.device_time_ns < b.device_time_ns for a, b in pairwise(frames)),
                "dropped": status.dropped,
            }
        )
    print("PULL", flush=True)
    said["lost"] = ""
    silences = 0
    while not said["lost"] and silences < 15:
        try:
            camera.read(1.0)
        except FrameTimeout:
            silences += 1
        except CameraLost as lost:
            said["lost"] = str(lost)
    camera.close()
    print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main()
