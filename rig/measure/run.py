"""Executes one run in several threads, from the first attempt at a start to the closed record."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from acquisition.frame import Frame
from acquisition.record.events import Event
from processing.errors import DataError
from rig.instrument import Snapshot
from rig.interruption import reason_of
from rig.measure.end_of_run import StopRequest
from rig.measure.recorder import Recorder
from rig.measure.recording import Recording
from rig.measure.run_losses import LossLog
from rig.measure.run_parts import RunOutcome, RunParts
from rig.measure.run_status import RunStatus
from rig.measure.start_judge import StartJudge

_log = logging.getLogger(__name__)


class Run:
    """One run: camera thread -> bounded queue -> processing thread -> recorder thread.

    The main thread displays the run.
    """

    def __init__(self, parts: RunParts) -> None:
        self._parts = parts
        self._stream = parts.stream
        self._status = RunStatus(parts.watchers, parts.devices, parts.optics.unit, parts.environment_period_s)
        self._stop = StopRequest(parts.stream)
        self._done = threading.Event()
        self._losses = LossLog(parts.stream, from_start=True)

    @property
    def snapshot(self) -> Snapshot:
        """State of the run; may be read from any thread."""
        return self._status.snapshot

    def request_stop(self, reason: str) -> None:
        """End the run soon; the first reason given is recorded."""
        self._stop.because(reason)

    def execute(
        self, show: Callable[[Snapshot], None] = lambda _: None, interval_s: float = 0.1
    ) -> RunOutcome:
        """Measure until the run ends; returns with the record closed.

        Ctrl-C and `Terminated` end it like `request_stop`, and immediately if frames come on demand. If
        the terminal was closed (`show` raises OSError), the run continues without it.
        """
        self._stream.start_camera()
        worker = threading.Thread(target=self._process, name="processing", daemon=True)
        worker.start()
        interrupt: KeyboardInterrupt | None = None
        try:
            while worker.is_alive():
                try:
                    show = self._watch(show, interval_s, worker.is_alive)
                except KeyboardInterrupt as error:
                    interrupt = interrupt or error
                    self._stop.skip_waiting = True
                    self.request_stop(reason_of(error))
        finally:
            # also after an interrupt or an error in the loop, so that the record is complete
            self.request_stop("the program has failed")
            worker.join()
        return RunOutcome(self.snapshot, self.snapshot.half_cycles, self._stop.failure, interrupt)

    def _watch(
        self, show: Callable[[Snapshot], None], interval_s: float, is_alive: Callable[[], bool]
    ) -> Callable[[Snapshot], None]:
        """Show the run until it ends; returns the function to be used for further output."""
        done = False
        while not done:
            done = self._done.wait(interval_s) or not is_alive()
            try:
                for instructing in self._status.take_instructions():
                    show(instructing)
                show(self.snapshot)
            except OSError as error:
                _log.warning("the display of the run failed, the run continues: %s", error)
                return _show_nothing
        return show

    def _process(self) -> None:
        """The processing thread, from the first frame to the closed record."""
        try:
            first = self._stream.begin()
            if first is None:
                raise DataError("the camera delivered no frame at all; nothing was recorded")
            epoch_offset_ns = time.time_ns() - first.time_ns - (time.monotonic_ns() - first.host_time_ns)
            number = 1
            while not self._attempt(number, epoch_offset_ns):
                number += 1
        except Exception as error:
            self._stop.failed(error)
        finally:
            # the main thread must learn that the run has ended, whatever else fails here
            try:
                self._shut_down()
            except Exception as error:
                self._stop.failed(error)
            finally:
                self._done.set()

    def _attempt(self, number: int, epoch_offset_ns: int) -> bool:
        """Make one attempt at a start and record it; False if it was rejected and is to be repeated."""
        parts = self._parts
        frames, events = self._first_frames()
        self._losses = LossLog(self._stream, from_start=parts.phases is None)
        preflight = () if parts.phases is None else parts.phases.verdicts
        recorder = Recorder(parts.record.open(epoch_offset_ns, frames[0], preflight))
        rejected = ""
        try:
            judge = None if parts.start is None else StartJudge(parts.start)
            recording = Recording(parts, self._stop, self._status, self._losses, recorder, judge)
            rejected = recording.make(frames, events)
        finally:
            recorder.close()
            if recorder.error is not None:
                self._stop.failed(recorder.error)
        if not rejected or parts.start is None or judge is None or recorder.error is not None:
            return True
        aside = parts.record.set_aside(number)
        if parts.phases is not None:
            parts.phases.correct_starter(judge.first_amplitude)
        parts.start_rejected(aside, rejected)
        if number >= parts.start.attempts:
            raise DataError(f"no start of {number} was accepted; the last: {rejected}")
        return False

    def _first_frames(self) -> tuple[list[Frame], list[Event]]:
        """The frames with which the record begins, at least one, and the events before them."""
        phases, stream = self._parts.phases, self._stream
        if phases is not None:
            frames, events = phases.run(stream, self._status.prepare, self._stop)
            if not frames:
                why = self._stop.reason or stream.ended or "stopped"
                raise stream.failure or DataError(f"{why} before the run began; nothing was recorded")
            return frames, events
        while not (stream.drained or self._stop):
            frames = stream.take(1, 0.1)
            if frames:
                return frames, []
        raise stream.failure or DataError("stopped before the run began; nothing was recorded")

    def _shut_down(self) -> None:
        self._stop.close_stream()
        losses = self._losses.now
        self._status.snapshot = replace(
            self.snapshot,
            phase="done",
            reason=self._stop.reason,
            dropped_frames=max(self.snapshot.dropped_frames, losses.total),
            losses=losses,
            instruction="",
        )


def _show_nothing(_: Snapshot) -> None:
    """Used in place of a terminal that was closed."""
