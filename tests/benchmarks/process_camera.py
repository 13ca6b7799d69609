"""The memory camera in a process of its own with a shared ring: acquisition outside Python's lock.

Measured against reading in a thread; decision 28 has what came of it.
"""

import contextlib
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.camera import CameraInfo, CameraSettings, CameraStatus, FrameTimeout
from acquisition.frame import Frame
from tests.benchmarks.memory_camera import RING_S, MemoryCamera

_HEAD = struct.Struct("<qqqqq")
"""Slot, number, time when it was due, time when it was taken, frames lost so far."""


class ProcessCamera:
    """Frames that another process takes when they are due, copies into a ring of shared memory and announces.

    The reader copies them out of the ring and acknowledges them; a frame that finds the ring full is lost.
    """

    def __init__(
        self, frames: list[np.ndarray[Any, Any]], full_scale_dn: int, rate_hz: float, duration_s: float
    ) -> None:
        self._frames = frames
        self._full_scale_dn = full_scale_dn
        self._rate_hz, self._duration_s = rate_hz, duration_s
        self._slots = max(4, round(RING_S * rate_hz))
        self._process: subprocess.Popen[bytes] | None = None
        memory = Path("/dev/shm")
        self._folder = tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None)
        self._lost = self._delivered = 0
        self.late_ns: list[int] = []
        """Of each frame, how late the other process took it."""
        self.taken_ns: list[int] = []
        """Of each frame, how late this one had it."""

    def open(self) -> CameraInfo:
        ny, nx = self._frames[0].shape
        return CameraInfo("memory", "", "", "", nx, ny, self._full_scale_dn, True)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def start(self) -> None:
        folder = Path(self._folder.name)
        np.save(folder / "frames.npy", np.array(self._frames))
        shape = (self._slots, *self._frames[0].shape)
        self._ring = np.memmap(folder / "ring", self._frames[0].dtype, "w+", shape=shape)
        words = [folder, self._slots, self._rate_hz, self._duration_s]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.benchmarks.process_camera", *map(str, words)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
        )

    def read(self, timeout_s: float) -> Frame | None:
        process = self._process
        if process is None or process.stdout is None or process.stdin is None:
            return None
        head = process.stdout.read(_HEAD.size)
        if head is None:
            raise FrameTimeout(f"process camera: no frame within {timeout_s:g} s")
        if len(head) < _HEAD.size:
            return None
        slot, number, due_ns, taken_ns, self._lost = _HEAD.unpack(head)
        image = np.array(self._ring[slot])
        with contextlib.suppress(BrokenPipeError):  # after its last frame it has ended
            process.stdin.write(b"t")
        self.late_ns.append(taken_ns - due_ns)
        self.taken_ns.append(time.monotonic_ns() - due_ns)
        self._delivered += 1
        return Frame(image, number, due_ns, taken_ns)

    def stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()

    def close(self) -> None:
        self.stop()
        self._folder.cleanup()

    @property
    def status(self) -> CameraStatus:
        return CameraStatus(delivered=self._delivered, dropped_by_host=self._lost)


def main() -> None:
    """The other process: takes frames when they are due."""
    folder, slots, rate_hz, duration_s = sys.argv[1:]
    frames = np.load(Path(folder) / "frames.npy", mmap_mode="r")
    ring = np.memmap(Path(folder) / "ring", frames.dtype, "r+", shape=(int(slots), *frames.shape[1:]))
    camera = MemoryCamera(list(frames), 255, float(rate_hz), float(duration_s))
    free, used = deque(range(int(slots))), deque[int]()
    refused = 0
    os.set_blocking(sys.stdin.fileno(), False)
    acknowledged = open(sys.stdin.fileno(), "rb", buffering=0)  # noqa: SIM115 - it is open already
    camera.start()
    while (frame := camera.read(5.0)) is not None:
        while used and (taken := acknowledged.read(len(used))):
            free.extend(used.popleft() for _ in taken)
        if not free:
            refused += 1
            continue
        slot = free.popleft()
        ring[slot] = frame.image
        used.append(slot)
        lost = camera.status.dropped_by_host + refused
        head = _HEAD.pack(slot, frame.sequence, frame.device_time_ns, frame.host_time_ns, lost)
        os.write(sys.stdout.fileno(), head)


if __name__ == "__main__":
    main()
