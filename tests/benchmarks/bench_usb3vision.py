"""USB3 Vision driver: unpacking, processor time per frame, 640 x 480 at 500 frames/s, 5 MP at 75 frames/s."""

import struct
import time
from typing import Any

import numpy as np

from acquisition.camera import CameraSettings
from acquisition.cameras.device_settings import Usb3VisionSettings
from acquisition.cameras.pixel_formats import BY_NAME
from acquisition.cameras.usb3vision.camera import Usb3VisionCamera
from acquisition.cameras.usb3vision.discovery import find_camera
from acquisition.cameras.usb3vision.link import UsbLink
from acquisition.cameras.usb3vision.registers import plan_transfers
from acquisition.cameras.usb3vision.stream import ExpectedFrames, UsbFrameStream
from acquisition.cameras.usb3vision.transfers import Arrived, Bytes
from tests.acquisition.cameras.usb3vision.backend import InProcessBackend
from tests.acquisition.cameras.usb3vision.device import VisionDevice
from tests.acquisition.cameras.usb3vision.packing import pack

WIDTH, HEIGHT = 640, 480
LARGE_WIDTH, LARGE_HEIGHT, LARGE_RATE_HZ = 2448, 2048, 75.0
PAGE = 4096


def unpacking(name: str, seconds: float) -> dict[str, float]:
    """Packed bytes in and pixels out, per second of one core; the best of repeated runs."""
    item = BY_NAME[name]
    pixels = np.random.default_rng(1).integers(0, item.full_scale_dn + 1, (HEIGHT, WIDTH))
    raw = np.frombuffer(pack(pixels, item.code), np.uint8)
    assert np.array_equal(item.image(raw, WIDTH, HEIGHT), pixels)
    out = np.empty(WIDTH * HEIGHT, np.uint16)
    assert item.kernel is not None
    best_s, end_s = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < end_s:
        begin_s = time.perf_counter()
        for _ in range(20):
            item.kernel(raw, out)
        best_s = min(best_s, (time.perf_counter() - begin_s) / 20)
    return {"packed_gb_per_s": raw.size / best_s / 1e9, "pixels_gb_per_s": out.nbytes / best_s / 1e9}


class _Memory:
    """Transfers without a bus: leader, payload and trailer lie ready; only our code takes time.

    With `touch` a byte of each page of a payload is written, so that the system has to find memory for it, as
    for what a controller writes.
    """

    frames_ahead = 1
    has_room = True
    under_way = False

    def __init__(
        self, frames: int, width_px: int, height_px: int, parts: int, *, touch: bool = False
    ) -> None:
        self.frames = frames
        self.served = 0
        self.part = 0
        self.payload_parts = parts
        self.touch = touch
        self.queued: list[Bytes] = []
        size = width_px * height_px
        self._leader = bytearray(52)
        self._trailer = bytearray(32)
        leader = (0x4C563355, 0, 52, 0, 0, 1, 0, 0x01080001, width_px, height_px, 0, 0, 0, 0)
        struct.pack_into("<IHHQHHQIIIIIHH", self._leader, 0, *leader)
        struct.pack_into("<IHHQHHQI", self._trailer, 0, 0x54563355, 0, 32, 0, 0, 0, size, height_px)

    def submit(self, buffer: Bytes) -> None:
        self.queued.append(buffer)

    def wait(self, timeout_s: float) -> Arrived:
        if self.served >= self.frames:
            time.sleep(0.01)
            raise TimeoutError
        buffer = self.queued.pop(0)
        last = self.payload_parts + 1
        part, self.part = self.part, (self.part + 1) % (last + 1)
        if 0 < part < last:  # the payload is in the buffer already, as if the controller had put it there
            if self.touch:
                buffer[::PAGE] = 0
            return Arrived(buffer.size, time.monotonic_ns())
        packet = self._leader if part == 0 else self._trailer
        packet[8:16] = self.served.to_bytes(8, "little")
        buffer[: len(packet)] = np.frombuffer(packet, np.uint8)
        self.served += part == last
        return Arrived(len(packet), time.monotonic_ns())

    def cancel(self) -> None:
        self.queued.clear()


def _transport_alone(memory: _Memory, sizes: tuple[int, ...]) -> None:
    """What the transfers themselves take: the same calls, into buffers that are there already."""
    buffers = [np.zeros(size, np.uint8) for size in sizes]
    for _ in range(memory.frames):
        for buffer in buffers:
            memory.submit(buffer)
            memory.wait(1.0)


def overhead(
    frames: int, width_px: int = WIDTH, height_px: int = HEIGHT, *, touch: bool = False
) -> dict[str, float]:
    """Processor time of our own code for each frame, from transfer to `Frame`, without the bus's part."""
    size = width_px * height_px
    plan = plan_transfers(size, 52, 32, 1024, 1 << 20)
    parts = sum(planned > 0 for planned in plan.payload)
    memory = _Memory(frames, width_px, height_px, parts, touch=touch)
    camera = find_camera(None, InProcessBackend(VisionDevice()))
    link = UsbLink(camera.device, camera.name)
    begin_s = time.process_time()
    stream = UsbFrameStream(memory, plan, ExpectedFrames(BY_NAME["Mono8"], width_px, height_px, True), link)
    taken = 0
    while taken < frames:
        taken += stream.reading.read(1.0) is not None
    spent_s = time.process_time() - begin_s
    stream.reading.stop(1.0)
    begin_s = time.process_time()
    alone = _Memory(frames, width_px, height_px, parts, touch=touch)
    _transport_alone(alone, (plan.leader, *plan.payload, plan.trailer))
    spent_s -= time.process_time() - begin_s
    return {"us_per_frame": spent_s / frames * 1e6}


def large_frames(frames: int, *, touch: bool) -> dict[str, float]:
    """5 MP at 75 frames/s: processor time, and which part of a core that is; the best of three."""
    best = min(overhead(frames, LARGE_WIDTH, LARGE_HEIGHT, touch=touch)["us_per_frame"] for _ in range(3))
    return {"us_per_frame": best, "percent_of_a_core": best * LARGE_RATE_HZ * 1e-4}


def full_speed(rate_hz: float, seconds: float, pixel_format: str = "mono8") -> dict[str, float]:
    """The whole driver against the camera made for the tests, at a rate that it keeps by the clock."""
    camera = Usb3VisionCamera(Usb3VisionSettings(), InProcessBackend(VisionDevice()))
    camera.open()
    settings = {"width_px": WIDTH, "height_px": HEIGHT, "exposure_us": 100.0, "frame_rate_hz": rate_hz}
    camera.configure(CameraSettings.model_validate(settings | {"pixel_format": pixel_format}))
    camera.start()
    count = int(rate_hz * seconds)
    cpu_s, begin_s = time.process_time(), time.perf_counter()
    worst_ns = 0
    for _ in range(count):
        frame = camera.read(2.0)
        assert frame is not None
        worst_ns = max(worst_ns, time.monotonic_ns() - frame.host_time_ns)
    spent_s, cpu_s = time.perf_counter() - begin_s, time.process_time() - cpu_s
    status = camera.status
    camera.close()
    return {
        "frames_per_s": count / spent_s,
        "dropped": status.dropped,
        "cpu_us_per_frame_with_the_camera_itself": cpu_s / count * 1e6,
        "worst_age_ms": worst_ns / 1e6,
    }


def run(quick: bool = False) -> dict[str, Any]:
    """Measure, print, return the numbers."""
    seconds = 0.2 if quick else 1.0
    results: dict[str, Any] = {
        name: unpacking(name, seconds) for name in ("Mono10p", "Mono12p", "Mono12Packed")
    }
    overhead(100)
    results["overhead"] = overhead(500 if quick else 3000)
    results["5 MP mono8 at 75/s"] = large_frames(100 if quick else 750, touch=False)
    results["the same with its memory"] = large_frames(100 if quick else 750, touch=True)
    results["640x480 mono8 at 500/s"] = full_speed(500.0, 1.0 if quick else 10.0)
    for name, values in results.items():
        print(f"{name:28}", ", ".join(f"{key} = {value:.4g}" for key, value in values.items()))
    return results


if __name__ == "__main__":
    run()
