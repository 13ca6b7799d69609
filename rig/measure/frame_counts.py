"""The frames of one run, counted, and what the record gets for them."""

from collections.abc import Sequence

from acquisition.frame import Frame
from acquisition.record.events import Event, EventKind
from processing.spot import BeamUse, SpotFlag, SpotModel
from processing.units import nanoseconds, seconds
from rig.instrument import Block, Pipeline
from rig.measure.recorder import Entry, cut_window

_LOST_IMAGE_INTERVAL_S = 1.0
_PREVIEW_NS = 300_000_000
_LOST_FOR_S = 5.0
"""After so long a person is told."""


class FrameCounts:
    """Counts of one run, whose record counts the frames' numbers from its first one."""

    def __init__(self, first: Frame, full_frame_interval_ns: int, *, keep_windows: bool) -> None:
        self.start_ns = first.time_ns
        self.last_ns = first.time_ns
        self.frames = 0
        self.missing = 0
        self.lost_spots = 0
        self.beam = BeamUse()
        self._model: SpotModel | None = None
        self._first_number = first.sequence
        self._interval_ns = full_frame_interval_ns
        self._keep_windows = keep_windows
        self._next_image_ns = first.time_ns
        self._next_lost_image_ns = first.time_ns
        self._next_preview_ns = first.time_ns
        self._next = self._first_number
        self._lost = False
        self._seen_ns = first.time_ns

    @property
    def elapsed_s(self) -> float:
        """Time from the first frame to the last one counted."""
        return seconds(self.last_ns - self.start_ns)

    @property
    def lost_text(self) -> str:
        """Since when the spot has been in no frame, once that is no blink; else empty."""
        if seconds(self.last_ns - self._seen_ns) < _LOST_FOR_S:
            return ""
        minutes, rest_s = divmod(seconds(self._seen_ns - self.start_ns), 60)
        return f"spot lost since {minutes:.0f}:{rest_s:04.1f}: laser on? beam on the sensor?"

    @property
    def beam_text(self) -> str:
        """The model of the beam, and whether it is chosen yet."""
        return self.beam.text if self._model is not None else f"{self.beam.text}, being judged"

    def entry(self, frames: Sequence[Frame], block: Block, pipeline: Pipeline) -> Entry:
        """The entry that the record gets for these frames."""
        numbers = [frame.sequence - self._first_number for frame in frames]
        events: list[Event] = []
        images: list[Frame] = []
        windows = []
        for number, frame, spot in zip(numbers, frames, block.spots, strict=True):
            time_ns = frame.time_ns
            gap = frame.sequence - self._next
            if gap > 0:
                self.missing += gap
                events.append(Event(time_ns, EventKind.GAP, f"frames missing before frame {number}: {gap}"))
            self._next = frame.sequence + 1
            lost = bool(spot.flags & SpotFlag.LOST)
            if lost != self._lost:
                events.append(
                    Event(
                        time_ns,
                        EventKind.SPOT_LOST if lost else EventKind.SPOT_FOUND,
                        f"at frame {number}",
                    )
                )
            self._lost = lost
            self._seen_ns = self._seen_ns if lost else time_ns
            self.lost_spots += lost
            if time_ns >= self._next_image_ns:
                images.append(frame._replace(sequence=number))
                self._next_image_ns = time_ns + self._interval_ns
            elif lost and time_ns >= self._next_lost_image_ns:
                images.append(frame._replace(sequence=number))
                self._next_lost_image_ns = time_ns + nanoseconds(_LOST_IMAGE_INTERVAL_S)
            bounds = (
                None
                if lost or not self._keep_windows
                else pipeline.tracker.record_window(spot, frame.image.shape)
            )
            windows.append(cut_window(frame, spot, bounds))
        preview = None
        if frames[-1].time_ns >= self._next_preview_ns:
            preview = frames[-1]._replace(sequence=numbers[-1])
            self._next_preview_ns = preview.time_ns + _PREVIEW_NS
        events += self._beam_events(numbers, block, pipeline, frames[-1].time_ns)
        self.frames += len(frames)
        self.last_ns = frames[-1].time_ns
        return Entry(
            sequences=numbers,
            device_times_ns=[frame.device_time_ns for frame in frames],
            host_times_ns=[frame.host_time_ns for frame in frames],
            block=block,
            windows=windows,
            images=images,
            preview=preview,
            events=events,
        )

    def _beam_events(
        self, numbers: Sequence[int], block: Block, pipeline: Pipeline, time_ns: int
    ) -> list[Event]:
        """An event when the tracker has chosen its model of the beam, or has begun to choose again."""
        self.beam.take(numbers, [spot.flags for spot in block.spots])
        before, self._model = self._model, pipeline.tracker.model
        if self._model is before:
            return []
        text = self.beam.text if self._model is not None else "it has changed; its model is chosen again"
        return [Event(time_ns, EventKind.BEAM, text)]
