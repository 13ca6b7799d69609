"""Numbers of lost frames, and the times at which frames are expected."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import sub
from typing import Final, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import CameraLost, CameraStatus, Frame

logger = logging.getLogger(__name__)

_MAX_GAP: Final = 1 << 31
"""A larger jump of a number means that the counter was reset, not that frames were lost."""
_MAX_LOSS_AT_WRAP: Final = 1000
"""Largest number of frames that can be lost where a counter begins again."""
_MIN_RISING_OLD_BLOCKS: Final = 3
"""This many old but rising numbers in a row are no late frames: the camera has begun to count again."""
LAST_SHORT_ID: Final = 65535
"""Last 16-bit number of a block, which is followed by 1; zero is not used (GigE Vision 1.x)."""
LossCause = Literal["dropped_by_camera", "dropped_by_bus", "dropped_by_host"]


class BlockNumbers:
    """Numbers the complete frames of the camera `name` from 0, and counts the others.

    `counters` are the numbers of blocks after which the camera may begin to count again. Where the camera has
    a clock, a block that came too late is recognised by its time.

    Attributes
    ----------
    lost_parts
        Number of frames since the last complete one that arrived in part.
    faulty
        Number of those that the camera marked as faulty.
    """

    def __init__(self, name: str, counters: Sequence[int], *, has_clock: bool = False) -> None:
        self._name, self._counters, self._has_clock = name, counters, has_clock
        self.lost_parts = self.faulty = 0
        self._last_block: int | None = None
        self._last_time = 0
        self._last_number = -1
        self._lost = CameraStatus()
        self._old_blocks: list[int] = []

    def lose_faulty(self) -> None:
        """Count a frame that came and that the camera or its driver marked as faulty."""
        self.lost_parts += 1
        self.faulty += 1

    def status(self, delivered: int) -> CameraStatus:
        """The counts, with `delivered` frames delivered."""
        newest = CameraStatus(delivered, incomplete=self.lost_parts - self.faulty, error_status=self.faulty)
        return self._lost + newest

    def number(self, block: int | None, lost: LossCause, time: int = 0) -> int | None:
        """Number of a complete frame; None for a block that came again or too late.

        `block` is None where the driver does not know it. `lost` is the place of the loss of frames missing
        before it, `time` the camera's clock in any unit. Raises CameraLost where the camera has reset itself.
        """
        # The step counts frames from the last one delivered. The first frame has no block number before it to
        # compare with, but damaged frames before it count.
        step = step_by_parts = 1 + self.lost_parts
        if block is not None and self._last_block is not None:
            step = block - self._last_block
            if step <= 0 and (time <= self._last_time if self._has_clock else not step):
                # sent again, or overtaken by a later block and counted as lost then
                logger.warning("%s: block %d came again or too late", self._name, block)
                self._lost += CameraStatus(wrong_id=1)
                self._refuse_restart(block)
                return None
        self._old_blocks.clear()
        if step < 0:
            step = next((step + n for n in self._counters if 0 < step + n <= _MAX_LOSS_AT_WRAP), step)
        if not 0 < step <= _MAX_GAP:
            logger.warning("%s: block number went from %s to %s", self._name, self._last_block, block)
            step = step_by_parts
        missing = step - 1
        partial = min(self.lost_parts, missing)
        faulty = min(self.faulty, partial)
        if missing:
            self._lost += CameraStatus(incomplete=partial - faulty, error_status=faulty)
            self._lost += CameraStatus(**{lost: missing - partial})
        self.lost_parts = self.faulty = 0
        self._last_block, self._last_time = block, time
        self._last_number += step
        return self._last_number

    def _refuse_restart(self, block: int) -> None:
        """Raise CameraLost where old block numbers and times rise again: the camera has reset itself."""
        if self._old_blocks and block <= self._old_blocks[-1]:
            self._old_blocks.clear()
        self._old_blocks.append(block)
        if len(self._old_blocks) >= _MIN_RISING_OLD_BLOCKS:
            raise CameraLost(
                f"{self._name}: its block numbers and its clock have begun again, at {block} "
                f"after {self._last_block}: it has reset itself; see its supply and its cable"
            )


@dataclass(frozen=True, slots=True)
class FrameLosses:
    """Numbers of lost frames by the place of the loss."""

    by_camera: int = 0
    """Frames that the camera numbered and did not send."""
    by_bus: int = 0
    """Frames that went missing between camera and driver."""
    by_host: int = 0
    """Frames that this program took too late, in the driver or after it."""
    incomplete: int = 0
    """Frames that arrived damaged and were discarded."""
    while_unplugged: int = 0
    """Frames that would have come while the camera was gone, estimated from the elapsed time."""
    wrong_time: int = 0
    """Frames whose times fitted neither the camera's rate nor the computer's clock."""
    error_status: int = 0
    """Frames that the camera or its driver marked as faulty."""
    wrong_id: int = 0
    """Frames that came again or too late, with an earlier number; none is missing because of them."""

    @classmethod
    def from_status(
        cls, status: CameraStatus, *, unqueued: int = 0, while_unplugged: int = 0, wrong_time: int = 0
    ) -> Self:
        """Losses from a driver's counts; `unqueued` frames were refused by the program's full queue."""
        return cls(
            status.dropped_by_camera,
            status.dropped_by_bus,
            status.dropped_by_host + unqueued,
            status.incomplete,
            while_unplugged,
            wrong_time,
            status.error_status,
            status.wrong_id,
        )

    @property
    def counts(self) -> tuple[int, ...]:
        """All numbers, in the order of the fields."""
        return tuple(getattr(self, name) for name in self.__slots__)

    @property
    def total(self) -> int:
        """Frames that are missing."""
        return sum(self.counts) - self.wrong_id

    @property
    def discarded(self) -> int:
        """Frames that came, in part at least, and were not used."""
        return self.incomplete + self.wrong_time + self.error_status + self.wrong_id

    @property
    def discarded_text(self) -> str:
        """The discarded frames by reason, in words."""
        return str(replace(self, by_camera=0, by_bus=0, by_host=0, while_unplugged=0))

    def since(self, earlier: "FrameLosses") -> "FrameLosses":
        """Losses since the counts `earlier`."""
        return FrameLosses(*map(sub, self.counts, earlier.counts))

    def __str__(self) -> str:
        words = (
            *("by the camera", "by the bus", "by this computer", "incomplete", "while unplugged"),
            *("with a wrong time", "with an error status", "with a repeated number"),
        )
        reasons = [f"{count} {word}" for count, word in zip(self.counts, words, strict=True) if count]
        return ", ".join(reasons) or "none"


_MIN_INTERVALS = 8
"""Number of intervals after which the frame time is known."""
SMOOTHING = 0.1
"""Fraction of each frame's deviation by which the learned interval is corrected."""
_DELAY_SMOOTHING = 0.02
"""As SMOOTHING, for the delay and its scatter."""
_MIN_DEVIATION_NS = 2_000_000.0
"""Smallest disagreement of times that counts: smaller ones come from reading or exposure."""
MAX_READING_DELAY_NS = 60_000_000.0
"""Largest disagreement with the computer's clock that late reading explains."""
MAX_IRREGULARITY = 0.2
"""Largest mean deviation of a regular camera's intervals, as a fraction of the interval."""
_MIN_SCATTER_NS = 20_000.0
"""Lower limit of the scatter of the delay."""
_IRREGULAR_PENALTY: Final = 0.6
"""Amount by which an irregular interval before a frame lowers its score of 1, so that a single outlier, which
spoils two intervals, is left out, and a frame between two gaps is kept."""
_FULL_IRREGULARITY: Final = 0.5
"""Relative deviation of a fully irregular interval."""
_NEWEST_INTERVALS: Final = 9
"""Number of newest intervals, whose median is taken as the camera's present interval."""


class FrameTiming:
    """Frame interval and delay, learned by `learn` from frames of valid times.

    Attributes
    ----------
    interval_ns, deviation_ns
        Smoothed interval of the frames, and smoothed deviation from it.
    intervals
        Number of intervals from which these were learned.
    delay_ns, scatter_ns
        Smoothed time from a frame's timestamp to its arrival, and the scatter of that time.
    last, last_read_at_arrival
        The last frame, and whether it was read when it arrived, not later from the driver.
    """

    def __init__(self) -> None:
        self.scatter_ns = _MIN_DEVIATION_NS
        self.interval_ns = 0.0
        self.restart()

    def restart(self) -> None:
        """Forget times and delay, after the camera was reopened; keep the frame interval."""
        self.last: Frame | None = None
        self.last_read_at_arrival = False
        self.deviation_ns = 0.0
        self.intervals = 0
        self.delay_ns = math.nan

    @property
    def is_regular(self) -> bool:
        """Whether the camera is known to keep a rate."""
        return self.intervals >= _MIN_INTERVALS and self.deviation_ns < MAX_IRREGULARITY * self.interval_ns

    @property
    def allowed_ns(self) -> float:
        """Allowed deviation of a time from the expected one, in ns."""
        return max(_MIN_DEVIATION_NS, 10 * self.deviation_ns) if self.is_regular else MAX_READING_DELAY_NS

    @property
    def allowed_by_arrival_ns(self) -> float:
        """Allowed deviation of a time from the one expected by the frame's arrival, in ns."""
        return max(3 * _MIN_DEVIATION_NS, 6 * self.scatter_ns)

    def early_ns(self, frame: Frame) -> float:
        """Camera's time minus (arrival minus usual delay), in ns: the step of the camera's clock, less the
        additional delay of a late reading.
        """
        return frame.device_time_ns - (frame.host_time_ns - self.delay_ns)

    def learn(self, frame: Frame) -> None:
        """Learn from a frame of valid time."""
        last, self.last = self.last, frame
        if last is not None:
            passed_ns, numbers = frame.time_ns - last.time_ns, frame.sequence - last.sequence
            self.last_read_at_arrival = frame.host_time_ns - last.host_time_ns > 0.5 * passed_ns
            if numbers > 0 and passed_ns > 0:
                off_ns = passed_ns / numbers - self.interval_ns
                if self.intervals:
                    self.deviation_ns += SMOOTHING * (abs(off_ns) - self.deviation_ns)
                self.interval_ns += (SMOOTHING if self.intervals else 1.0) * off_ns
                self.intervals += 1
        delay_ns = float(frame.host_time_ns - frame.device_time_ns)
        if math.isnan(self.delay_ns) or self.intervals < _MIN_INTERVALS:
            # the first frames may have been read late, so the smallest delay counts
            self.delay_ns = delay_ns if math.isnan(self.delay_ns) else min(delay_ns, self.delay_ns)
        elif self.last_read_at_arrival:
            # the delay of a frame that has lain in the driver says nothing
            excess_ns, limit_ns = delay_ns - self.delay_ns, 2 * self.scatter_ns
            self.delay_ns += _DELAY_SMOOTHING * min(max(excess_ns, -limit_ns), limit_ns)
            wider_ns = min(abs(excess_ns), limit_ns) - self.scatter_ns
            self.scatter_ns = max(self.scatter_ns + _DELAY_SMOOTHING * wider_ns, _MIN_SCATTER_NS)

    def time_by_arrival(self, frame: Frame) -> Frame:
        """The frame with the time of its arrival less the usual delay, smoothed by the camera's rate."""
        time_ns, last = frame.host_time_ns - self.delay_ns, self.last
        if last is not None:
            numbers = frame.sequence - last.sequence
            by_rate_ns = last.device_time_ns + numbers * self.interval_ns
            excess_ns, limit_ns = time_ns - by_rate_ns, 2 * self.scatter_ns
            if self.intervals >= _MIN_INTERVALS and numbers > 0 and abs(excess_ns) < MAX_READING_DELAY_NS:
                time_ns = by_rate_ns + _DELAY_SMOOTHING * min(max(excess_ns, -limit_ns), limit_ns)
            time_ns = max(time_ns, last.device_time_ns + 1)
        self.last = frame._replace(device_time_ns=round(time_ns))
        return self.last


class RisingTimes(NamedTuple):
    """Frames whose times rise regularly, and the first frame after a step of the clock."""

    consistent: list[int]
    """Indices of the frames with consistent times."""
    first_after_step: int | None = None
    """Index of the first frame after the step; None without a step."""


def rising_times(
    times_ns: Sequence[float], numbers: Sequence[int], interval_ns: float, step_ns: float = 0.0
) -> RisingTimes:
    """Select the most frames whose times rise from the last sure one, at the camera's intervals.

    Times and numbers are counted from the last sure frame. The camera may have changed its interval, which
    the newest frames show; frames without numbers may be missing anywhere. With a step, all times from some
    frame on are later by `step_ns`; that frame is chosen so that the intervals are most regular.
    """
    time = np.concatenate(([0.0], np.asarray(times_ns, dtype=np.float64)))
    number = np.concatenate(([0], np.asarray(numbers, dtype=np.int64)))
    newest_ns = (np.diff(time) / np.maximum(np.diff(number), 1))[-_NEWEST_INTERVALS:]
    newest_ns = newest_ns[newest_ns > 0]
    present_ns = float(np.median(newest_ns)) if len(newest_ns) else 0.0
    usual_ns = [usual for usual in (interval_ns, present_ns) if usual > 0]
    # best sequence that ends at each frame, before (row 0) and after (row 1) the step: score, predecessor
    score = np.full((2, len(time)), -np.inf)
    score[0, 0] = 0.0
    predecessor = np.zeros((2, len(time)), np.int64)
    steps_at = np.zeros(len(time), np.bool_)
    for i in range(1, len(time)):
        passed_ns, intervals = time[i] - time[:i], np.maximum(number[i] - number[:i], 1)
        onwards = score[:, :i] + _score(passed_ns, intervals, usual_ns)
        predecessor[:, i] = np.argmax(onwards, axis=1)
        score[:, i] = np.max(onwards, axis=1)
        if step_ns:
            stepping = score[0, :i] + _score(passed_ns - step_ns, intervals, usual_ns)
            best = int(np.argmax(stepping))
            if stepping[best] > score[1, i]:
                score[1, i], predecessor[1, i], steps_at[i] = stepping[best], best, True
    row = 1 if step_ns else 0
    i = int(np.argmax(score[row]))
    if score[row, i] == -np.inf:
        return RisingTimes([])
    consistent: list[int] = []
    first_after_step: int | None = None
    while i:
        consistent.append(i - 1)
        previous = int(predecessor[row, i])
        if row and steps_at[i]:
            first_after_step, row = i - 1, 0
        i = previous
    return RisingTimes(consistent[::-1], first_after_step)


def _score(
    passed_ns: NDArray[np.float64], intervals: NDArray[np.int64], usual_ns: list[float]
) -> NDArray[np.float64]:
    """Scores of frames by the intervals before them: 1 (regular) to 0.4; -inf where time does not rise."""
    interval_ns = passed_ns / intervals
    off = np.ones(len(interval_ns))
    for usual in usual_ns:
        off = np.minimum(off, np.abs(interval_ns - usual) / (_FULL_IRREGULARITY * usual))
    return np.where(passed_ns > 0, 1.0 - _IRREGULAR_PENALTY * off, -np.inf)
