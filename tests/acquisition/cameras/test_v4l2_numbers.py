"""Numbers of a video camera's frames, whatever its driver counts."""

from collections.abc import Iterator

import numpy as np

from acquisition.camera import Frame
from acquisition.cameras.v4l2.camera import _Streaming
from acquisition.cameras.v4l2.linux import RawFrame


class Counted:
    """A source with these numbers; None stands for a buffer that the driver marks as faulty."""

    def __init__(self, numbers: list[tuple[int, bool]]) -> None:
        self._numbers: Iterator[tuple[int, bool]] = iter(numbers)

    def next(self, timeout_s: float) -> RawFrame:
        number, good = next(self._numbers)
        return RawFrame(np.zeros((2, 2), np.uint8) if good else None, number, number, number, late=False)

    def stop(self) -> None:
        pass


def test_numbers_go_on_where_the_driver_counts_again_and_every_frame_has_a_reason() -> None:
    shown = [(7, True), (8, False), (10, True), (11, True), (0, True), (1, True), (3, True)]
    run = _Streaming(Counted(shown))  # type: ignore[arg-type]
    frames = [frame for frame in (run._step(0.1) for _ in shown) if isinstance(frame, Frame)]
    numbers = [frame.sequence for frame in frames]
    assert numbers == [0, 3, 4, 5, 6, 8]
    assert (run.status.error_status, run.status.dropped_by_bus) == (1, 2)
    assert numbers[-1] + 1 - len(numbers) == run.status.dropped
