"""The last seconds of frames before a record begins, and the wait for the end of a phase."""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from acquisition.camera import Frame
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import RecordedPhase
from processing.deflections import Deflections, joined
from processing.errors import DataError
from processing.units import nanoseconds, seconds
from rig.devices import FrameStream
from rig.instrument import Block, Optics, Phase, Pipeline
from rig.measure.end_of_run import StopRequest
from rig.measure.preflight import TrialFrames

_BLOCK_FRAMES = 16
_MAX_FRAMES_BYTES = 256 * 1024 * 1024
_MIN_FRAMES = 8
"""Frames that are kept whatever their size."""
_TAKE_WITHIN_S = 0.1


class RecentFrames:
    """Takes frames, tracks the spot, and keeps the deflections of the last `window_s` seconds.

    The frames themselves are kept for `frames_s` seconds, or as many as `_MAX_FRAMES_BYTES` hold, because a
    release is detected only afterwards, and the record must begin before it. `watch` receives some frames,
    and the spots and deflections measured in them.
    """

    def __init__(
        self,
        stream: FrameStream,
        optics: Optics,
        frames_s: float,
        window_s: float,
        watch: Callable[[Sequence[Frame], Block], object],
    ) -> None:
        self._stream, self._optics, self._watch = stream, optics, watch
        self._pipeline: Pipeline | None = None
        self._frames: deque[Frame] = deque()
        self._blocks: deque[Block] = deque()
        self._frames_ns, self._window_ns = nanoseconds(frames_s), nanoseconds(window_s)
        self._last_spot_ns = self.frames_taken = 0

    def advance(self) -> bool:
        """Take some frames; False if the stream has ended."""
        frames = self._stream.take(_BLOCK_FRAMES, _TAKE_WITHIN_S)
        if not frames:
            return not self._stream.drained
        if self._pipeline is None:
            self._pipeline = Pipeline(self._optics, frames[0].image.shape)
        block = self._pipeline.process(frames, estimated=False)
        self._blocks.append(block)
        times_ns = block.deflections.times_ns
        found_ns = times_ns[block.deflections.found]
        self._last_spot_ns = int(found_ns[-1]) if len(found_ns) else self._last_spot_ns or int(times_ns[0])
        self._frames.extend(frames)
        self._watch(frames, block)
        self.frames_taken += len(frames)
        newest_ns = frames[-1].time_ns
        max_frames = max(_MIN_FRAMES, _MAX_FRAMES_BYTES // max(frames[0].image.nbytes, 1))
        while newest_ns - self._frames[0].time_ns > self._frames_ns or len(self._frames) > max_frames:
            self._frames.popleft()
        while newest_ns - self._blocks[0].deflections.times_ns[-1] > self._window_ns:
            self._blocks.popleft()
        return True

    @property
    def spotless_s(self) -> float:
        """Time since a spot was last found, or since the first frame."""
        return seconds(self.now_ns - self._last_spot_ns) if self._blocks else 0.0

    @property
    def now_ns(self) -> int:
        """Time of the newest frame; 0 before the first."""
        return int(self._blocks[-1].deflections.times_ns[-1]) if self._blocks else 0

    @property
    def frames(self) -> list[Frame]:
        """The frames of the last `frames_s` seconds, oldest first."""
        return list(self._frames)

    @property
    def newest(self) -> tuple[float, float]:
        """Deflection (x, y) of the newest frame; NaN if the spot is lost."""
        if not self._blocks:
            return np.nan, np.nan
        deflections = self._blocks[-1].deflections
        return float(deflections.x[-1]), float(deflections.y[-1])

    def since(self, time_ns: int) -> Deflections:
        """Deflections from a time on, in the frames' clock."""
        return joined((block.deflections for block in self._blocks), self._optics.unit).since(time_ns)

    def trial(self, resting: bool, duration_s: float) -> TrialFrames:
        """Frames, spots and deflections of the last `duration_s` seconds."""
        from_ns = self.now_ns - nanoseconds(duration_s)
        deflections = self.since(from_ns)
        spots = [spot for block in self._blocks for spot in block.spots]
        references = [spot for block in self._blocks for spot in block.references]
        earlier_spots = len(spots) - len(deflections)
        return TrialFrames(
            [frame for frame in self._frames if frame.time_ns >= from_ns],
            spots[earlier_spots:],
            deflections,
            resting,
            None if self._pipeline is None else self._pipeline.tracker.model,
            references[earlier_spots:],
        )

    def window_bytes(self) -> float:
        """Bytes of the window around the spot that a record keeps of each frame; 0 before the first frame."""
        if self._pipeline is None:
            return 0.0
        image = self._frames[-1].image
        x0, y0, x1, y1 = self._pipeline.tracker.record_window(self._blocks[-1].spots[-1], image.shape)
        return float((x1 - x0) * (y1 - y0) * image.itemsize)


_NO_SPOT = "no spot is seen: check the laser, the beam path and the camera's region"
_MAX_SPOTLESS_S = 3.0


class WaitStopped(Exception):
    """The operator stopped the wait, or the frames have ended."""


_VERB = {Phase.REST: "reached", Phase.RELEASE: "seen"}
"""What is said of a phase that has ended; "finished" of all others."""


class PhaseWait:
    """Waits for one phase after another: takes frames, reports the state, collects events.

    `progress` describes how far the present phase is, in words.
    """

    def __init__(
        self, frames: RecentFrames, report: Callable[[RecordedPhase], None], stop: StopRequest
    ) -> None:
        self.frames = frames
        self._report = report
        self._stop = stop
        self.progress = ""
        self.events: list[Event] = []

    def note(self, kind: EventKind, text: str) -> None:
        """Add an event at the time of the newest frame."""
        self.events.append(Event(self.frames.now_ns, kind, text))

    def until_reached(
        self,
        phase: Phase,
        limit_s: float,
        reached: Callable[[float], bool],
        instruction: str = "",
        every_s: float = 0.0,
    ) -> None:
        """Take frames until `reached` is True; it is called every `every_s` with the phase's duration in s.

        Raises DataError after `limit_s`, and `WaitStopped` if the run is stopped or the frames end.
        """
        frames = self.frames
        began_ns = frames.now_ns
        check_due_ns = 0
        self.progress = ""
        while True:
            if self._stop or not frames.advance():
                self.note(EventKind(phase), "stopped")
                raise WaitStopped
            now_ns = frames.now_ns
            began_ns = began_ns or now_ns
            elapsed_s = seconds(now_ns - began_ns)
            message = instruction
            if frames.spotless_s > _MAX_SPOTLESS_S:
                self.progress = f"no spot is seen for {frames.spotless_s:.0f} s"
                message = _NO_SPOT
            self._report(RecordedPhase(now_ns, elapsed_s, phase.value, self.progress, message))
            if now_ns and now_ns >= check_due_ns:
                check_due_ns = now_ns + nanoseconds(every_s)
                if reached(elapsed_s):
                    progress = f", {self.progress}" if self.progress else ""
                    self.note(
                        EventKind(phase), f"{_VERB.get(phase, 'finished')} after {elapsed_s:.1f} s{progress}"
                    )
                    return
            if elapsed_s > limit_s:
                raise DataError(
                    f"{phase}: not reached within {limit_s:g} s ({self.progress or 'nothing happened'}); "
                    "remove the cause, or raise its limit in the configuration"
                )
