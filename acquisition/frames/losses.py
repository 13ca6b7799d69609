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

_LARGEST_GAP: Final = 1 << 31
"""A larger jump of a number means that the counter was reset, not that frames were lost."""
_MAX_LOSS_AT_WRAP: Final = 1000
"""Largest number of frames that can be lost where a counter begins again."""
_MIN_RISING_OLD_NUMBERS: Final = 3
"""This many old but rising numbers in a row are no late frames: the camera has begun to count again."""
LAST_SHORT_ID: Final = 65535
"""Last 16-bit number of a block, which is followed by 1; zero is not used (GigE Vision 1.x)."""
LossCause = Literal["dropped_by_camera", "dropped_by_bus", "dropped_by_host"]


class BlockNumbers:
    """Numbers the complete frames of the camera `name` from 0, and counts the others.

    `counters` are the numbers of blocks after which a camera may begin again. Where the camera has a clock, a
    block that came too late is recognised by its time. Since the last complete frame, `lost_parts` counts the
    frames that arrived in part, and `faulty` those of them that the camera marked as faulty.
    """

    def __init__(self, name: str, counters: Sequence[int], *, has_clock: bool = False) -> None:
        self._name, self._counters, self._has_clock = name, counters, has_clock
        self.lost_parts = self.faulty = 0
        self._last_block: int | None = None
        self._last_time = 0
        self._last_number = -1
        self._lost = CameraStatus()
        self._stale: list[int] = []

    def lose_faulty(self) -> None:
        """Count a frame that came and that the camera or its driver marked as faulty."""
        self.lost_parts += 1
        self.faulty += 1

    def status(self, delivered: int) -> CameraStatus:
        """The counts, with `delivered` frames delivered."""
        since = CameraStatus(delivered, incomplete=self.lost_parts - self.faulty, error_status=self.faulty)
        return self._lost + since

    def number(self, block: int | None, lost: LossCause, time: int = 0) -> int | None:
        """Number of a complete frame; None for a block that came again or too late.

        `block` is None where the driver does not know it. `lost` is the place of the loss of frames missing
        before it, `time` the camera's clock in any unit. Raises CameraLost where the camera has reset itself.
        """
        # The step counts frames from the last one delivered. The first frame has no block number before it to
        # compare with, but damaged frames before it count.
        after_parts = 1 + self.lost_parts
        step = after_parts
        if block is not None and self._last_block is not None:
            step = block - self._last_block
            if step <= 0 and (time <= self._last_time if self._has_clock else not step):
                # sent again, or overtaken by a later block and counted as lost then
                logger.warning("%s: block %d came again or too late", self._name, block)
                self._lost += CameraStatus(wrong_id=1)
                self._refuse_restart(block)
                return None
        self._stale.clear()
        if step < 0:
            step = next((step + n for n in self._counters if 0 < step + n <= _MAX_LOSS_AT_WRAP), step)
        if not 0 < step <= _LARGEST_GAP:
            logger.warning("%s: block number went from %s to %s", self._name, self._last_block, block)
            step = after_parts
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
        if self._stale and block <= self._stale[-1]:
            self._stale.clear()
        self._stale.append(block)
        if len(self._stale) >= _MIN_RISING_OLD_NUMBERS:
            raise CameraLost(
                f"{self._name}: its block numbers and its clock have begun again, at {block} "
                f"after {self._last_block}: it has reset itself; see its supply and its cable"
            )


@dataclass(frozen=True, slots=True)
class FrameLosses:
    """Numbers of lost frames by the place of the loss.

    Attributes
    ----------
    by_camera
        The camera numbered them and did not send them.
    by_bus
        They went missing between camera and driver.
    by_host
        This program took them too late, in the driver or after it.
    incomplete
        They arrived damaged and were discarded.
    while_unplugged
        They would have come while the camera was gone, estimated from the elapsed time.
    wrong_time
        Their times fitted neither the camera's rate nor the computer's clock.
    error_status
        The camera or its driver marked them as faulty.
    wrong_id
        They came again or too late, with an earlier number; none is missing because of them.
    """

    by_camera: int = 0
    by_bus: int = 0
    by_host: int = 0
    incomplete: int = 0
    while_unplugged: int = 0
    wrong_time: int = 0
    error_status: int = 0
    wrong_id: int = 0

    @classmethod
    def from_status(
        cls, status: CameraStatus, *, unqueued: int = 0, while_unplugged: int = 0, wrong_time: int = 0
    ) -> Self:
        """Losses from a driver's counts, and from frames that the program's queue refused, that were missed
        while the camera was unplugged, or that had wrong times.
        """
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

    def since(self, before: "FrameLosses") -> "FrameLosses":
        """Losses since the counts `before`."""
        return FrameLosses(*map(sub, self.counts, before.counts))

    def __str__(self) -> str:
        words = (
            *("by the camera", "by the bus", "by this computer", "incomplete", "while unplugged"),
            *("with a wrong time", "with an error status", "with a repeated number"),
        )
        named = [f"{count} {word}" for count, word in zip(self.counts, words, strict=True) if count]
        return ", ".join(named) or "none"


_FRAMES_TO_LEARN = 8
"""Frames after which the frame time is known."""
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
_LEAST_SCATTER_NS = 20_000.0
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

    `waited_for`: the last frame was read at arrival, not late from the driver.
    """

    def __init__(self) -> None:
        self.scatter_ns = _MIN_DEVIATION_NS
        self.interval_ns = 0.0
        self.restart()

    def restart(self) -> None:
        """Forget times and delay, after the camera was reopened; keep the frame interval."""
        self.last: Frame | None = None
        self.waited_for = False
        self.deviation_ns = 0.0
        self.learned = 0
        self.delay_ns = math.nan

    @property
    def is_regular(self) -> bool:
        """Whether the camera is known to keep a rate."""
        return self.learned >= _FRAMES_TO_LEARN and self.deviation_ns < MAX_IRREGULARITY * self.interval_ns

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

    def off_by_rate_ns(self, frame: Frame, last: Frame) -> float:
        """Deviation of a time from the camera's rate since `last`, ns."""
        return (
            frame.device_time_ns - last.device_time_ns - (frame.sequence - last.sequence) * self.interval_ns
        )

    def learn(self, frame: Frame) -> Frame:
        """Learn from a frame of valid time; returns it."""
        last, self.last = self.last, frame
        if last is not None:
            passed_ns, numbers = frame.time_ns - last.time_ns, frame.sequence - last.sequence
            self.waited_for = frame.host_time_ns - last.host_time_ns > 0.5 * passed_ns
            if numbers > 0 and passed_ns > 0:
                off_ns = passed_ns / numbers - self.interval_ns
                if self.learned:
                    self.deviation_ns += SMOOTHING * (abs(off_ns) - self.deviation_ns)
                self.interval_ns += (SMOOTHING if self.learned else 1.0) * off_ns
                self.learned += 1
        delay_ns = float(frame.host_time_ns - frame.device_time_ns)
        if math.isnan(self.delay_ns) or self.learned < _FRAMES_TO_LEARN:
            # the first frames may have been read late, so the smallest delay counts
            self.delay_ns = min(delay_ns, delay_ns if math.isnan(self.delay_ns) else self.delay_ns)
        elif self.waited_for:
            # a frame that was not waited for has lain in the driver, and its delay says nothing
            later_ns = delay_ns - self.delay_ns
            most_ns = 2 * self.scatter_ns
            self.delay_ns += _DELAY_SMOOTHING * min(max(later_ns, -most_ns), most_ns)
            wider_ns = min(abs(later_ns), most_ns) - self.scatter_ns
            self.scatter_ns = max(self.scatter_ns + _DELAY_SMOOTHING * wider_ns, _LEAST_SCATTER_NS)
        return frame

    def time_by_arrival(self, frame: Frame) -> Frame:
        """The frame with the time of its arrival less the usual delay, smoothed by the camera's rate."""
        arrived_ns = frame.host_time_ns - self.delay_ns
        last = self.last
        time_ns = arrived_ns
        if last is not None:
            numbers = frame.sequence - last.sequence
            by_rate_ns = last.device_time_ns + numbers * self.interval_ns
            later_ns = arrived_ns - by_rate_ns
            if self.learned >= _FRAMES_TO_LEARN and numbers > 0 and abs(later_ns) < MAX_READING_DELAY_NS:
                most_ns = 2 * self.scatter_ns
                time_ns = by_rate_ns + _DELAY_SMOOTHING * min(max(later_ns, -most_ns), most_ns)
            time_ns = max(time_ns, last.device_time_ns + 1)
        self.last = frame._replace(device_time_ns=round(time_ns))
        return self.last


class RisingTimes(NamedTuple):
    """Indices of the frames with consistent times, and of the first frame after the step (None: no step)."""

    kept: list[int]
    first_after_step: int | None = None


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
    newest = (np.diff(time) / np.maximum(np.diff(number), 1))[-_NEWEST_INTERVALS:]
    newest = newest[newest > 0]
    usual = [one for one in (interval_ns, float(np.median(newest)) if len(newest) else 0.0) if one > 0]
    # best sequence that ends at each frame, before (row 0) and after (row 1) the step: score, predecessor
    score = np.full((2, len(time)), -np.inf)
    score[0, 0] = 0.0
    predecessor = np.zeros((2, len(time)), np.int64)
    steps_at = np.zeros(len(time), np.bool_)
    for i in range(1, len(time)):
        passed_ns, between = time[i] - time[:i], np.maximum(number[i] - number[:i], 1)
        onwards = score[:, :i] + _score(passed_ns, between, usual)
        predecessor[:, i] = np.argmax(onwards, axis=1)
        score[:, i] = np.max(onwards, axis=1)
        if step_ns:
            stepping = score[0, :i] + _score(passed_ns - step_ns, between, usual)
            at = int(np.argmax(stepping))
            if stepping[at] > score[1, i]:
                score[1, i], predecessor[1, i], steps_at[i] = stepping[at], at, True
    after = 1 if step_ns else 0
    i = int(np.argmax(score[after]))
    if score[after, i] == -np.inf:
        return RisingTimes([])
    kept: list[int] = []
    first_after: int | None = None
    while i:
        kept.append(i - 1)
        before = int(predecessor[after, i])
        if after and steps_at[i]:
            first_after, after = i - 1, 0
        i = before
    return RisingTimes(kept[::-1], first_after)


def _score(
    passed_ns: NDArray[np.float64], numbers: NDArray[np.int64], usual: list[float]
) -> NDArray[np.float64]:
    """Scores of frames by the intervals before them: 1 (regular) to 0.4; -inf where time does not rise."""
    each_ns = passed_ns / numbers
    off = np.ones(len(each_ns))
    for one in usual:
        off = np.minimum(off, np.abs(each_ns - one) / (_FULL_IRREGULARITY * one))
    return np.where(passed_ns > 0, 1.0 - _IRREGULAR_PENALTY * off, -np.inf)
