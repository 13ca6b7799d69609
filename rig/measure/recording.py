"""Makes one record: processes frames and hands the results to the recorder until the run ends."""

import math
import time
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from acquisition.camera import Frame, Image
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import (
    RecordedHealth,
    RecordedLosses,
    RecordedNote,
    RecordedPhase,
    TimedMessage,
)
from processing.deflections import DeflectionUnit, no_deflections
from processing.errors import DeviceError
from processing.spot import BeamUse, SpotFlag, SpotModel
from processing.units import ARCSEC_RAD, nanoseconds, seconds
from rig.instrument import Block, Phase, Pipeline, RecordContents
from rig.measure.end_of_run import EndOfRun
from rig.measure.posterior_worker import Posterior
from rig.measure.readings import SideReadings, StepEvents
from rig.measure.recorder import RecordEntry, Recorder
from rig.measure.session_orders import StartJudge

if TYPE_CHECKING:
    from rig.measure.run import MeasurementRun

_LIVE_FIT = "the live fit"
_LIVE_PICTURE = "the live picture"

_BLOCK_FRAMES = 64
_MAX_BLOCK_NS = 2_000_000_000
"""Longest time span of a block, so that a run with a slow camera ends when it should."""
_PUBLISH_INTERVAL_NS = 10_000_000
"""Shortest time between two published states of the run; a screen cannot show more of them."""

_LOST_IMAGE_INTERVAL_NS, _PREVIEW_INTERVAL_NS = 1_000_000_000, 300_000_000
_TAKE_WITHIN_S = 0.1
_MIN_LOST_S = 5.0
"""Shortest loss of the spot that is reported to the operator."""


class FrameCounts:
    """Counts of frames and losses of one run; it numbers the frames of a record from 0."""

    def __init__(self, first: Frame, full_frame_interval_ns: int, *, keep_windows: bool) -> None:
        self.start_ns = self.last_ns = self._last_spot_ns = first.time_ns
        self.frames = self.missing = self.lost_spots = 0
        self.beam = BeamUse()
        self._model: SpotModel | None = None
        self._first_number = first.sequence
        self._interval_ns = full_frame_interval_ns
        self._keep_windows = keep_windows
        self._image_due_ns = self._lost_image_due_ns = self._preview_due_ns = first.time_ns
        self._next_sequence = first.sequence
        self._was_lost = False

    @property
    def elapsed_s(self) -> float:
        """Time from the first frame to the last one counted."""
        return seconds(self.last_ns - self.start_ns)

    @property
    def lost_text(self) -> str:
        """Text that says since when the spot is lost, once that lasts for `_MIN_LOST_S`; else empty."""
        if seconds(self.last_ns - self._last_spot_ns) < _MIN_LOST_S:
            return ""
        minutes, rest_s = divmod(round(seconds(self._last_spot_ns - self.start_ns), 1), 60)
        return f"spot lost since {minutes:.0f}:{rest_s:04.1f}: laser on? beam on the sensor?"

    @property
    def beam_text(self) -> str:
        """The model of the beam, and whether the choice of it is still open, in words."""
        return self.beam.text if self._model is not None else f"{self.beam.text}, being judged"

    def record_entry(self, frames: Sequence[Frame], block: Block, pipeline: Pipeline) -> RecordEntry:
        """The record's entry for these frames."""
        numbers = [frame.sequence - self._first_number for frame in frames]
        events: list[Event] = []
        images: list[Frame] = []
        windows: list[tuple[Image, int, int] | None] = []
        for number, frame, spot in zip(numbers, frames, block.spots, strict=True):
            time_ns = frame.time_ns
            missing = frame.sequence - self._next_sequence
            if missing > 0:
                self.missing += missing
                text = f"frames missing before frame {number}: {missing}"
                events.append(Event(time_ns, EventKind.GAP, text))
            self._next_sequence = frame.sequence + 1
            is_lost = bool(spot.flags & SpotFlag.LOST)
            if is_lost != self._was_lost:
                kind = EventKind.SPOT_LOST if is_lost else EventKind.SPOT_FOUND
                events.append(Event(time_ns, kind, f"at frame {number}"))
            self._was_lost = is_lost
            self._last_spot_ns = self._last_spot_ns if is_lost else time_ns
            self.lost_spots += is_lost
            is_due = time_ns >= self._image_due_ns
            if is_due:
                self._image_due_ns = time_ns + self._interval_ns
            elif is_lost and time_ns >= self._lost_image_due_ns:
                is_due = True
                self._lost_image_due_ns = time_ns + _LOST_IMAGE_INTERVAL_NS
            if is_due:
                images.append(frame._replace(sequence=number))
            windows.append(None)
            if not is_lost and self._keep_windows:
                x0, y0, x1, y1 = pipeline.tracker.record_window(spot, frame.image.shape)
                # a copy, so that the memory of the frame can be freed
                windows[-1] = (frame.image[y0:y1, x0:x1].copy(), x0, y0)
        preview = None
        if frames[-1].time_ns >= self._preview_due_ns:
            preview = frames[-1]._replace(sequence=numbers[-1])
            self._preview_due_ns = preview.time_ns + _PREVIEW_INTERVAL_NS
        # an event when the tracker has chosen its model of the beam, or has begun to choose again
        self.beam.take(numbers, [spot.flags for spot in block.spots])
        old_model, self._model = self._model, pipeline.tracker.model
        if self._model is not old_model:
            text = "it has changed; its model is chosen again" if self._model is None else self.beam.text
            events.append(Event(frames[-1].time_ns, EventKind.BEAM, text))
        self.frames += len(frames)
        self.last_ns = frames[-1].time_ns
        return RecordEntry(
            sequences=numbers,
            device_times_ns=[frame.device_time_ns for frame in frames],
            host_times_ns=[frame.host_time_ns for frame in frames],
            block=block,
            windows=windows,
            images=images,
            preview=preview,
            events=events,
        )


class Recording:
    """Makes one record in the processing thread, from its `first` frame on.

    Without a `judge` any start is accepted.
    """

    def __init__(
        self, run: "MeasurementRun", recorder: Recorder, judge: StartJudge | None, first: Frame
    ) -> None:
        self._run, self._stream = run, run.stream
        self._stop, self._status, self._guard = run.stop, run.status, run.guard
        self._recorder, self._judge = recorder, judge
        self._first = self._last = first
        self._waiting: list[Frame] = []
        # frames made on demand wait for all other threads, so that a run of the simulated rig repeats exactly
        self._on_demand = run.stream.policy == "wait"
        settings = run.plan.config.record
        interval_ns = nanoseconds(settings.full_frame_interval_s)
        self._counts = FrameCounts(first, interval_ns, keep_windows=settings.windows)
        self._pipeline = Pipeline(
            run.optics, first.image.shape, threaded=not self._on_demand, guard=run.guard
        )
        config = run.plan.config
        # without a lever the amplitude in arcsec is unknown, and only the time limit applies
        has_lever = run.optics.unit is DeflectionUnit.RAD
        final_rad = config.session.final_amplitude_arcsec * ARCSEC_RAD if has_lever else 0.0
        stop_when = () if run.posterior is None else config.stop_conditions
        self._end = EndOfRun(final_rad, config.session.max_duration_s, stop_when)
        self._steps = StepEvents(run.optics.unit)
        self._readings = SideReadings(run, first.time_ns)
        self._published_ns = self._half_cycles = 0

    def record(self, frames: list[Frame], events: list[Event]) -> str:
        """Record until the run ends; returns why the start was rejected, else an empty text.

        The record begins with `frames`, and with `events` before them. An error raised here ends the run and
        is recorded as an event.
        """
        try:
            self._waiting = frames
            self._begin(events)
            rejection = self._take_all()
            self._close(rejection)
        except Exception as error:
            last_ns = self._counts.last_ns
            text = f"{type(error).__name__}: {error}"
            kinds = (EventKind.FAILED, EventKind.STOP)
            # watchers are informed now, because closing the devices may take seconds
            self._record(RecordEntry(events=[Event(last_ns, kind, text) for kind in kinds]))
            raise
        return rejection

    def _begin(self, earlier: list[Event]) -> None:
        self._status.begin_record()
        if self._run.posterior is not None:
            self._guard.call(_LIVE_FIT, None, self._run.posterior.begin, self._run.plan.record)
        start = Event(self._first.time_ns, EventKind.START, "first frame")
        self._record(RecordEntry(events=[*earlier, start]))

    def _take_all(self) -> str:
        """Take the waiting frames, then those of the stream; returns why the start was rejected, or ''."""
        stream = self._stream
        # all frames from a source on demand are processed, frames of a live camera only until the stop
        while self._waiting or not (stream.drained or (self._stop and not self._on_demand)):
            block = self._take()
            if self._recorder.error is not None:
                raise self._recorder.error
            self._end_in_darkness()
            if block is None:
                continue
            elapsed_s = self._counts.elapsed_s
            if self._judge is not None:
                rejection = self._judge.rejection(block.half_cycles, block.balances, elapsed_s)
                if rejection:
                    return rejection
            reason = self._end.reason(block.half_cycles, elapsed_s, self._posterior.estimates)
            if reason is not None:
                self._stop.request(reason)
            if reason is not None or (self._stop and self._stop.skip_waiting):
                break
        if stream.end_reason:
            self._stop.request(stream.end_reason, None if stream.failure is None else EventKind.FAILED)
        return ""

    def _take(self) -> Block | None:
        """Take some frames, process and record them; None if there were none in time."""
        counts, run, stream = self._counts, self._run, self._stream
        frames = self._waiting or stream.take(_BLOCK_FRAMES, _TAKE_WITHIN_S)
        # blocks on demand are full, so that a run ends at the same frame however frames arrive
        while self._on_demand and len(frames) < _BLOCK_FRAMES and not stream.drained:
            frames += stream.take(_BLOCK_FRAMES - len(frames), _TAKE_WITHIN_S)
        if not frames:
            # events do not wait for frames, so that a silent camera is noted immediately
            messages = [*self._notes(), *self._state(Phase.MEASURING, math.nan)]
            self._record(RecordEntry(events=self._device_events(), messages=messages))
            return None
        taken_ns, end_ns = time.monotonic_ns(), frames[0].time_ns + _MAX_BLOCK_NS
        late = (k for k, frame in enumerate(frames) if frame.time_ns > end_ns)
        count = min(_BLOCK_FRAMES, next(late, len(frames)))
        frames, self._waiting = frames[:count], frames[count:]
        block = self._pipeline.process(frames)
        self._half_cycles += len(block.half_cycles)
        entry = counts.record_entry(frames, block, self._pipeline)
        self._last = frames[-1]
        messages, clock_events = self._readings.take(frames)
        step_events: list[Event] = self._guard.call("the watch for steps", [], self._steps.take, block)
        entry.events = [*entry.events, *step_events, *clock_events, *self._device_events()]
        entry.messages = [*messages, *self._notes()]
        self._record(entry)
        if run.posterior is not None:
            callbacks = self._recorder.flush, stream.note_deliberate_wait
            self._guard.call(_LIVE_FIT, None, run.posterior.take, block.half_cycles, *callbacks)
        is_due = taken_ns - self._published_ns > _PUBLISH_INTERVAL_NS
        if block.half_cycles or self._on_demand or is_due:
            self._published_ns = taken_ns
            # frames made on demand have no age
            age_s = math.nan if self._on_demand else seconds(taken_ns - frames[0].host_time_ns)
            self._record(RecordEntry(messages=self._state(Phase.MEASURING, age_s)))
        look = partial(run.plan.session_news.look, recorded=True)
        self._guard.call(_LIVE_PICTURE, None, look, frames, block)
        return block

    def _close(self, rejection: str) -> None:
        """Record the half-cycles completed by the end, and how the run has ended."""
        counts, (half_cycles, balances) = self._counts, self._pipeline.finish()
        attachments = self._readings.end_attachments()
        if not rejection:
            # the stream is closed first, so that the record names a camera that cannot be stopped
            self._stop.close_stream()
        end = Event(counts.last_ns, EventKind.STOP, self._stop.reason)
        if rejection:
            end = Event(counts.last_ns, EventKind.REJECTED, f"start not accepted: {rejection}")
        if self._guard.text:
            text = f"in all: {self._guard.text}"
            self._recorder.put(RecordEntry(events=[Event(counts.last_ns, EventKind.WATCHER_FAILED, text)]))
        early = [] if rejection or self._stop.early is None else [end._replace(kind=self._stop.early)]
        self._half_cycles += len(half_cycles)
        losses = RecordedLosses(counts.last_ns, *self._stream.losses.counts)
        self._record(
            RecordEntry(
                block=Block([], no_deflections(self._run.optics.unit), half_cycles, balances),
                events=[*self._device_events(), *early, end],
                messages=[losses, *self._state(Phase.CLOSING, math.nan), *self._notes()],
                attachments=attachments,
            )
        )

    def _record(self, entry: RecordEntry) -> None:
        """Record an entry, unless it is empty, and inform the watchers, for whom notes are events, too."""
        block, counts = entry.block, self._counts
        half_cycles, balances = ([], []) if block is None else (block.half_cycles, block.balances)
        if block is not None or entry.events or entry.messages:
            self._recorder.put(entry)
        if half_cycles or balances or entry.events or entry.messages:
            notes = [message.event for message in entry.messages if isinstance(message, RecordedNote)]
            events = [*entry.events, *notes]
            self._status.tell(
                RecordContents(counts.start_ns, counts.last_ns, half_cycles, balances, events, entry.messages)
            )

    def _notes(self) -> list[TimedMessage]:
        """Notes of the operators since the last call, timed by the frames' clock."""
        counts, last = self._counts, self._last
        notes = list[TimedMessage]()
        for host_time_ns, author, text in self._run.plan.take_notes():
            time_ns = last.time_ns + host_time_ns - last.host_time_ns
            # notes typed before the record begins belong to it, and frames on demand have another clock
            time_ns = min(max(time_ns, counts.start_ns), counts.last_ns)
            notes.append(RecordedNote(time_ns, host_time_ns, author, text))
        return notes

    def _end_in_darkness(self) -> None:
        """End the run if the laser is dark, unless it may wait for light and an operator is present."""
        alarm, run = self._status.light.alarm, self._run
        if not alarm or self._stop or (run.waits_when_dark and run.operator_present):
            return
        why = "nobody is at the terminal or a desk" if run.waits_when_dark else "laser.when_dark = 'end'"
        self._stop.failed(DeviceError(f"{alarm}; the run ends: {why}"))

    @property
    def _posterior(self) -> Posterior:
        posterior = self._run.posterior
        if posterior is None:
            return Posterior()
        return self._guard.call(_LIVE_FIT, Posterior(), lambda: posterior.latest)

    def _device_events(self) -> list[Event]:
        """Events of camera, disk, controller, laser and sensors since the last call."""
        events = self._stream.take_events() + self._status.take_events()
        for paused_s in self._recorder.take_pauses():
            text = f"did not answer for {paused_s:.1f} s; frames waited in memory meanwhile"
            events.append((EventKind.SLOW_DISK, text))
        posterior = self._run.posterior
        if posterior is not None and (remark := self._guard.call(_LIVE_FIT, "", posterior.take_remark)):
            events.append((EventKind.LIVE_FIT, remark))
        return [Event(self._counts.last_ns, kind, text) for kind, text in events]

    def _state(self, phase: Phase, age_s: float) -> list[TimedMessage]:
        """Messages on the state of the session that have changed since the last call."""
        counts, recorder, clock = self._counts, self._recorder, self._readings.clock
        now_ns = counts.last_ns
        # while the laser is dark nobody needs to look for the spot
        instruction = "" if phase is not Phase.MEASURING or self._status.light.alarm else counts.lost_text
        if instruction:
            instruction += f" rig camera align {self._run.plan.config.command_words}"
        health = RecordedHealth(
            now_ns,
            counts.frames,
            counts.missing,
            counts.lost_spots,
            self._half_cycles,
            len(self._stream),
            recorder.bytes_written,
            age_s,
            recorder.disk_free_bytes,
            recorder.disk_silent_s,
            clock.drift_ppm,
            clock.u_drift_ppm,
            self._status.light.alarm or recorder.alarm,
            counts.beam_text,
        )
        recorded = RecordedPhase(now_ns, counts.elapsed_s, phase.value, "", instruction, self._stop.reason)
        return self._status.messages(recorded, health, self._posterior, on_demand=self._on_demand)
