"""A stream at default settings with what came out of it, and a driver that gives what it is told to."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from acquisition.camera import Camera, CameraSettings, CameraStatus, Frame, FrameTimeout
from acquisition.frames.queue import Policy
from rig.devices.frame_stream import FrameStream

WITHIN_S = 60.0


@dataclass
class Driver:
    """Somebody's own: a plain read, and a word for everything else."""

    make: Callable[[int], object]
    count: int = 0
    lost_by: CameraStatus | None = None
    asked_s: list[float] = field(default_factory=list)
    """Timeouts of all reads."""

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def read(self, timeout_s: float) -> object:
        self.asked_s.append(timeout_s)
        self.count += 1
        return self.make(self.count - 1)

    @property
    def status(self) -> CameraStatus:
        return self.lost_by or CameraStatus(delivered=self.count)


def frames_of(
    count: int, *, silences: int = 0, rate_hz: float = 100.0, shape: tuple[int, int] = (2, 2)
) -> Callable[[int], Frame | None]:
    """So many frames by a clock of their own, then silence for so many reads, then the end; all at once."""

    def make(number: int) -> Frame | None:
        if count <= number < count + silences:
            raise FrameTimeout("no frame")
        time_ns = round(1e9 * (number + 1) / rate_hz)
        return Frame(np.zeros(shape, np.uint8), number, time_ns, number + 1) if number < count else None

    return make


class Run:
    """A stream at default settings, and what came out of it."""

    def __init__(self, camera: Camera, asked: CameraSettings, policy: Policy = "drop") -> None:
        self.camera = camera
        self.stream = FrameStream(self.camera, asked, policy=policy, applied=self.camera.configure(asked))
        self.stream.start_camera()
        assert self.stream.begin() is not None
        self.frames: list[Frame] = []
        self.texts: list[tuple[str, str]] = []

    @property
    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.texts]

    @property
    def numbers(self) -> list[int]:
        return [frame.sequence for frame in self.frames]

    def until(self, reached: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + WITHIN_S
        while not reached():
            assert time.monotonic() < deadline_s, (self.kinds, self.stream.end_reason)
            self.frames += self.stream.take(64, 0.1)
            self.texts += self.stream.take_events()

    def until_number(self, last: int) -> None:
        """Take frames up to this number."""
        self.until(lambda: bool(self.frames) and self.frames[-1].sequence >= last)

    def more(self, count: int = 20, kind: str = "") -> None:
        """So many more frames, and an event of this kind."""
        before = len(self.frames)
        self.until(lambda: len(self.frames) > before + count and (not kind or kind in self.kinds))

    def close(self, *, failed: bool = False) -> None:
        self.stream.close()
        self.camera.close()
        if failed:
            assert self.stream.failure is not None
        else:
            assert self.stream.failure is None
            # every number once, and what is missing counted
            assert self.numbers == sorted(set(self.numbers))
            assert self.numbers[-1] + 1 - len(self.numbers) == self.stream.losses.total
