"""Times of a record's frames with the steps of the camera's clock taken off, as `FrameClock` does live."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from rig.devices.frame_clock import ClockStep, FrameClock

Integers = NDArray[np.int64]

_LEAST_NS = 2_000_000
_NO_IMAGE = np.zeros((1, 1), np.uint8)


class MendedTimes(NamedTuple):
    """What is added to the times of a record's frames.

    `sequence` (n,) are the frames that have a right time, in order, `added_ns` (n,) what their times lack;
    `steps` are times, as they were recorded, and the steps before them; `left_out` counts the other frames.
    """

    sequence: Integers
    added_ns: Integers
    steps: tuple[tuple[int, ClockStep], ...]
    left_out: int


def mended_times(sequence: Integers, device_ns: Integers, host_ns: Integers) -> MendedTimes | None:
    """The corrections of recorded frames, (n,) each; None where the clock never stepped.

    A camera without a clock (times below 0) has nothing to be corrected.
    """
    numbers = np.diff(sequence)
    if len(numbers) == 0 or device_ns.min() < 0:
        return None
    passed_ns = np.diff(device_ns).astype(float)
    by_rate_ns = numbers * float(np.median(passed_ns / np.maximum(numbers, 1)))
    by_host_ns = np.diff(host_ns)
    off_ns = np.minimum(np.abs(passed_ns - by_rate_ns), np.abs(passed_ns - by_host_ns))
    if off_ns.max() < _LEAST_NS and passed_ns.min() > 0:
        return None
    clock = FrameClock()
    kept: list[int] = []
    added: list[int] = []
    steps: list[tuple[int, ClockStep]] = []
    recorded = dict(zip(sequence.tolist(), device_ns.tolist(), strict=True))
    for number, device, host in zip(sequence.tolist(), device_ns.tolist(), host_ns.tolist(), strict=True):
        seen = clock.take(Frame(_NO_IMAGE, number, device, host))
        if seen.step is not None:
            steps.append((recorded[seen.frames[seen.after_step].sequence], seen.step))
        for frame in seen.frames:
            kept.append(frame.sequence)
            added.append(frame.device_time_ns - recorded[frame.sequence])
    if not steps and len(kept) == len(sequence):
        return None
    return MendedTimes(np.array(kept), np.array(added), tuple(steps), len(sequence) - len(kept))
