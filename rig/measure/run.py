"""One run: from the first frame to a closed record."""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from acquisition.camera import Camera, CameraSettings
from acquisition.frame import Frame
from acquisition.frame_queue import Policy
from acquisition.record.writer import RecordWriter
from processing.angle import ARCSEC_RAD
from processing.errors import DataError, RigError
from processing.swing import Swing
from rig.devices import FrameStream
from rig.instrument import Event, Pipeline, Snapshot
from rig.interruption import reason_of
from rig.measure.frame_counts import FrameCounts
from rig.measure.live_state import PublicState
from rig.measure.loss_log import LossLog
from rig.measure.recorder import Entry, Recorder
from rig.measure.roles import Attempts, Prelude, RunOutcome, Surroundings, Watcher
from rig.measure.start_and_end import EndOfRun, StartJudge

_log = logging.getLogger(__name__)
_BLOCK_FRAMES = 64


class Run:
    """Camera thread -> bounded queue -> processing thread -> recorder thread, and a place to watch from.

    The camera must be open and configured. `make_pipeline` gets the sensor's shape, `open_writer`
    the offset from the frames' clock to UTC: both are known with the first frame. `policy` says
    whether the camera is held back ("wait") or loses frames, counted, when we are too slow.
    Without a `prelude` the record begins with the camera's first frame.
    """

    def __init__(
        self,
        camera: Camera,
        settings: CameraSettings,
        make_pipeline: Callable[[tuple[int, int]], Pipeline],
        open_writer: Callable[[int, Frame], RecordWriter],
        end: EndOfRun,
        *,
        amplitude_unit_rad: float = ARCSEC_RAD,
        policy: Policy = "every",
        timeout_s: float = 5.0,
        reconnect_s: float = 60.0,
        full_frame_interval_s: float = 10.0,
        keep_windows: bool = True,
        watchers: Iterable[Watcher] = (),
        prelude: Prelude | None = None,
        attempts: Attempts | None = None,
        surroundings: Surroundings | None = None,
        environment_period_s: float = 1.0,
    ) -> None:
        self._camera = camera
        self._stream = FrameStream(
            camera, settings, policy=policy, timeout_s=timeout_s, reconnect_s=reconnect_s
        )
        self._make_pipeline = make_pipeline
        self._open_writer = open_writer
        self._end = end
        self._full_frame_interval_ns = round(full_frame_interval_s * 1e9)
        self._keep_windows = keep_windows
        self._public = PublicState(watchers, surroundings, amplitude_unit_rad, environment_period_s)
        self._prelude = prelude
        self._attempts = attempts
        self._stop = threading.Event()
        self._done = threading.Event()
        self._reason = ""
        self._at_once = False
        self._failure: Exception | None = None
        self._losses = LossLog(self._stream, from_start=True)

    @property
    def snapshot(self) -> Snapshot:
        """State of the run; may be read from any thread."""
        return self._public.snapshot

    def request_stop(self, reason: str) -> None:
        """End the run soon; the first reason given is the one that is recorded."""
        if not self._stop.is_set():
            self._reason = reason
            self._stop.set()
            self._stream.request_stop()

    def execute(
        self, show: Callable[[Snapshot], None] = lambda _: None, interval_s: float = 0.1
    ) -> RunOutcome:
        """Measure until the run ends; returns with the record closed.

        Ctrl-C and `Terminated` end it as a request does, and at once where the camera waits for us. A
        screen that has gone (OSError of `show`) is not written to any more; the run goes on.
        """
        self._camera.start()
        worker = threading.Thread(target=self._process, name="processing", daemon=True)
        worker.start()
        interrupt: KeyboardInterrupt | None = None
        try:
            while worker.is_alive():
                try:
                    show = self._watch(show, interval_s, worker.is_alive)
                except KeyboardInterrupt as error:
                    interrupt = interrupt or error
                    self._at_once = True
                    self.request_stop(reason_of(error))
        finally:
            # also where an interrupt or an error has left the loop: nothing is left half written
            self.request_stop("the program has failed")
            worker.join()
        return RunOutcome(self.snapshot, self.snapshot.half_cycles, self._failure, interrupt)

    def _watch(
        self, show: Callable[[Snapshot], None], interval_s: float, lives: Callable[[], bool]
    ) -> Callable[[Snapshot], None]:
        """Show the run until it ends; returns what is to be shown with from then on."""
        done = False
        while not done:
            done = self._done.wait(interval_s) or not lives()
            try:
                for asked in self._public.take_asked():
                    show(asked)
                show(self.snapshot)
            except OSError as error:
                _log.warning("the run is not shown any more: %s", error)
                return _unseen
        return show

    def _process(self) -> None:
        """The processing thread: owns the pipeline from the first frame to the closed record."""
        try:
            first = self._stream.begin()
            if first is None:
                raise DataError("the camera delivered no frame at all; nothing was recorded")
            epoch_offset_ns = time.time_ns() - first.time_ns - (time.monotonic_ns() - first.host_time_ns)
            number = 1
            while not self._attempt(number, epoch_offset_ns):
                number += 1
        except Exception as error:
            self._fail(error, str(error))
        finally:
            # whatever fails here too, the one who waits for the end hears of it
            try:
                self._shut_down()
            except Exception as error:
                self._fail(error, str(error))
            finally:
                self._done.set()

    def _attempt(self, number: int, epoch_offset_ns: int) -> bool:
        """Prepare, record, judge the start; False where it was not accepted and is to be repeated."""
        begun: list[Frame] = []
        events: list[Event] = []
        if self._prelude is not None:
            begun, events = self._prelude(self._stream, self._public.prepare, self._stop.is_set)
            if not begun:
                why = self._reason or self._stream.ended or "stopped"
                raise self._stream.failure or DataError(f"{why} before the run began; nothing was recorded")
        first = begun[0] if begun else self._wait_first()
        if first is None:
            raise self._stream.failure or DataError("stopped before the run began; nothing was recorded")
        begun = begun or [first]
        self._losses = LossLog(self._stream, from_start=self._prelude is None)
        recorder = Recorder(self._open_writer(epoch_offset_ns, first))
        rejected = ""
        try:
            judge = self._attempts.make_judge() if self._attempts is not None else None
            rejected = self._measure(begun, events, recorder, judge)
        finally:
            recorder.close()
            if recorder.error is not None:
                self._fail(recorder.error, str(recorder.error))
        if not rejected or self._attempts is None or recorder.error is not None:
            return True
        self._attempts.set_aside(number, rejected)
        if number >= self._attempts.most:
            raise DataError(f"no start of {number} was accepted; the last: {rejected}")
        return False

    def _wait_first(self) -> Frame | None:
        while not self._stream.drained and not self._stop.is_set():
            frames = self._stream.take(1, 0.1)
            if frames:
                return frames[0]
        return None

    def _measure(
        self, begun: list[Frame], events: list[Event], recorder: Recorder, judge: StartJudge | None
    ) -> str:
        """Record until the run ends; why the start was not accepted, or nothing."""
        first, stream = begun[0], self._stream
        pipeline = self._make_pipeline((first.image.shape[0], first.image.shape[1]))
        counts = FrameCounts(first, self._full_frame_interval_ns, keep_windows=self._keep_windows)
        self._public.begin_record()
        events = [*events, Event(first.time_ns, "start", "first frame")]
        recorder.put(Entry(events=events))
        self._public.tell_events(counts.start_ns, events)
        rejected = ""
        while begun or not (stream.drained or (self._stop.is_set() and stream.policy != "wait")):
            taken = begun[:_BLOCK_FRAMES] or stream.take(_BLOCK_FRAMES, 0.1)
            taken_ns = time.monotonic_ns()
            begun = begun[_BLOCK_FRAMES:]
            if not taken:
                # a silent camera is named while it is silent
                new = self._surrounding_events(counts.last_ns)
                if new:
                    recorder.put(Entry(events=new))
                    self._public.tell_events(counts.start_ns, new)
                continue
            frames = counts.numbered(taken)
            block = pipeline.process(frames)
            entry = counts.entry(frames, block, pipeline)
            new = [*entry.events, *self._surrounding_events(counts.last_ns)]
            recorder.put(
                replace(
                    entry,
                    events=new,
                    environment=self._public.environment(counts.last_ns),
                    losses=self._losses.due(counts.last_ns),
                )
            )
            # where the camera waits for us its frames have no age of their own
            age_s = math.nan if stream.policy == "wait" else (taken_ns - taken[0].host_time_ns) * 1e-9
            self._publish("measuring", counts, block.swings, recorder, age_s)
            self._public.tell(counts.start_ns, frames, block, new)
            if recorder.error is not None:
                raise recorder.error
            if judge is not None:
                rejected = judge.rejection(block.swings, block.balances, counts.elapsed_s)
                if rejected:
                    break
            reason = self._end.reason(block.swings, counts.elapsed_s)
            if reason is not None:
                self.request_stop(reason)
                break
            if self._stop.is_set() and self._at_once:
                break
        if stream.ended and not rejected:
            self.request_stop(stream.ended)
        swings = pipeline.finish()
        empty = pipeline.measure(np.empty(0, np.int64), [])._replace(swings=swings)
        last = [*self._surrounding_events(counts.last_ns)]
        last.append(
            Event(counts.last_ns, "stop", f"start not accepted: {rejected}" if rejected else self._reason)
        )
        recorder.put(Entry(block=empty, events=last, losses=self._losses.last(counts.last_ns)))
        self._publish("closing the record", counts, swings, recorder, math.nan)
        self._public.tell(counts.start_ns, [], empty, last)
        return rejected

    def _surrounding_events(self, time_ns: int) -> list[Event]:
        happened = self._stream.take_events() + self._public.take_events()
        return [Event(time_ns, kind, text) for kind, text in happened]

    def _fail(self, error: Exception, reason: str) -> None:
        if self._failure is None:
            self._failure = error
        if not isinstance(error, RigError):
            _log.error("%s", reason, exc_info=error)
        self.request_stop(reason)

    def _shut_down(self) -> None:
        stream = self._stream
        self._stop.set()
        stream.close()
        if stream.failure is not None:
            if self._failure is None:
                self._failure = stream.failure
            self._reason = self._reason or stream.ended
        losses = self._losses.now
        self._public.snapshot = replace(
            self.snapshot,
            phase="done",
            reason=self._reason,
            dropped_frames=max(self.snapshot.dropped_frames, losses.total),
            losses=losses,
            instruction="",
        )

    def _publish(
        self, phase: str, counts: FrameCounts, swings: list[Swing], recorder: Recorder, age_s: float
    ) -> None:
        self._public.publish(
            Snapshot(
                phase=phase,
                elapsed_s=counts.elapsed_s,
                frames=counts.frames,
                dropped_frames=counts.missing,
                lost_spots=counts.lost_spots,
                queue_frames=len(self._stream),
                frame_age_s=age_s,
                losses=self._losses.now,
                record_bytes=recorder.bytes_written,
                reason=self._reason,
            ),
            swings,
        )


def _unseen(_: Snapshot) -> None:
    """Shows nothing: nobody is there any more."""
