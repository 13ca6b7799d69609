"""Sets up one run and executes it in several threads, to the closed record."""

import json
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from acquisition.camera import Frame
from acquisition.frames.queue import MAX_QUEUE_BYTES
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import RecordedLosses, RecordedPhase
from acquisition.record.writer import RecordWriter
from processing import decay_summary
from processing.errors import ConfigurationError, DataError, DeviceError, RecordError
from rig.devices import Devices, FrameStream, OpenCamera, TypedAcknowledgement
from rig.instrument import (
    ObserverGuard,
    Optics,
    Phase,
    RecordContents,
    RunNow,
    configuration_attachments,
    optics_of,
    prepare_kernels,
    reference_px,
    session_metadata,
)
from rig.interruption import reason_of
from rig.measure.end_of_run import StopRequest
from rig.measure.phases import PhasesBeforeRecord, free_bytes, phases_wanted
from rig.measure.posterior import LivePosterior, live_posterior
from rig.measure.recorder import Recorder
from rig.measure.recording import Recording
from rig.measure.run_parts import RunOutcome, RunPlan, features_json, set_aside
from rig.measure.run_status import RunStatus, Watcher
from rig.measure.screen import RunDisplay
from rig.measure.session_orders import StartJudge
from rig.terminal import Verdict, plain_values, say
from rig.view import RunningView

_MAX_PAUSE_S = 60.0
"""Longest time without progress before a thread that hangs is abandoned; it allows for a slow disk."""
_MAX_PAUSE_AFTER_INTERRUPT_S = 2.0
"""Longest time without progress after a second interrupt."""
_DONE_INTERVAL_S = 0.1
"""Interval between two looks at whether the processing thread has ended."""


@dataclass(slots=True, kw_only=True)
class MeasurementRun:
    """One run: camera thread -> bounded queue -> processing thread -> recorder thread.

    The main thread displays the run.
    """

    plan: RunPlan
    camera: OpenCamera
    """Open and configured, not started."""
    optics: Optics
    """Calibrated values for the conversion of frames to deflections."""
    stream: FrameStream
    """The camera's frames."""
    devices: Devices
    """Controller, laser and environment sensor, whose events and readings are recorded."""
    phases: PhasesBeforeRecord | None = None
    """Phases before the record; None: the record begins with the camera's first frame."""
    watchers: Sequence[Watcher] = ()
    """Receive what is recorded."""
    posterior: LivePosterior | None = None
    """The live fit; None without one."""
    typed_acknowledgement: TypedAcknowledgement | None = None
    """Acknowledgements of a trip that a person types at the terminal."""
    guard: ObserverGuard = field(init=False, default_factory=ObserverGuard)
    """Catches the errors of observers."""
    status: RunStatus = field(init=False)
    """State of the run, passed on to the watchers."""
    stop: StopRequest = field(init=False)
    """Request to end the run."""
    _done: threading.Event = field(init=False, default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.status = RunStatus(self.watchers, self.devices, self.optics.unit, self.guard)
        self.stop = StopRequest(self.stream)

    @property
    def waits_when_dark(self) -> bool:
        """Whether a run whose laser goes dark waits for a person to relight it; otherwise it ends."""
        return self.plan.config.laser.when_dark == "wait"

    @property
    def operator_present(self) -> bool:
        """Whether a person at the terminal or a desk could acknowledge a trip and ask for light."""
        typed = self.typed_acknowledgement
        return (typed is not None and typed.available) or self.plan.session_news.is_watched

    def open_record(self, epoch_offset_ns: int, first: Frame, preflight: Sequence[Verdict]) -> RecordWriter:
        """Create the file with configuration, provenance and preflight table.

        `epoch_offset_ns` is UTC minus the time of the frames' clock, `first` the first frame of the record.
        """
        config, camera, lever = self.plan.config, self.camera, self.optics.lever
        attachments = configuration_attachments(config, self.plan.source)
        if features := features_json(camera.camera):
            attachments["camera-features-start.json"] = features
        if preflight:
            attachments["preflight.json"] = json.dumps(plain_values(preflight), indent=1).encode()
        # the settings that were read back from the camera
        applied = camera.applied.model_dump(exclude_none=True)
        settings = {key: str(value) for key, value in applied.items()} | {
            "stamped": config.camera.stamped or camera.info.stamped,
            "time_shift_ns": str(camera.time_shift_ns),
        }
        writer = RecordWriter(
            self.plan.record,
            epoch_offset_ns,
            metadata=session_metadata(config, camera.info, first) | {"camera_settings": settings},
            attachments=attachments,
            deflection_unit=self.optics.unit,
        )
        if lever is not None:
            shape = (first.image.shape[0], first.image.shape[1])
            distance_px = lever.arm_m / lever.pixel_pitch_m
            writer.write_camera_calibration(first.time_ns, shape, distance_px, reference_px(lever, shape))
        return writer

    def execute(self, show: Callable[[RunNow], None] = lambda _: None) -> RunOutcome:
        """Measure until the run ends; returns with the record closed.

        Ctrl-C and `Terminated` switch the laser off and end the run early, at once if frames come on demand.
        A thread that hangs at the end is abandoned, sooner after a second interrupt.
        """
        self.stream.start_camera()
        threading.Thread(target=self._process, name="processing", daemon=True).start()
        interrupt: KeyboardInterrupt | None = None
        stopped, hangs = False, ""
        try:
            self._watch(show)
        except KeyboardInterrupt as error:
            interrupt = error
            self.stop.skip_waiting = True
            self._darken(reason_of(error))
            stopped = self.stop.request(reason_of(error), EventKind.ENDED_EARLY)
        finally:
            # also after an interrupt or an error, so that the record is complete
            self.stop.request("the program has failed", EventKind.FAILED)
            hangs = self._end(show)
        return RunOutcome(self.status.now, self.stop.failure, interrupt, stopped, hangs)

    def _darken(self, why: str) -> None:
        """Refuse light from now on and ask for the laser to be switched off; nothing here can block."""
        self.devices.permit.withdraw(why)
        self.devices.darken(why)

    def _end(self, show: Callable[[RunNow], None]) -> str:
        """Wait for the end of the processing thread; returns what hung, if it had to be abandoned."""
        max_pause_s = _MAX_PAUSE_S
        # the thread is not joined: an interrupted join takes a running thread for one that has ended
        is_done = False
        while not is_done:
            try:
                paused_s = self.stream.permit.paused_s
                if paused_s > max_pause_s and not self._done.is_set():
                    return f"nothing was processed or recorded for {paused_s:.0f} s"
                is_done = self._done.wait(_DONE_INTERVAL_S)
                self._show(show, self._now_with_stall())
            except KeyboardInterrupt:
                max_pause_s = _MAX_PAUSE_AFTER_INTERRUPT_S
        return ""

    def _watch(self, show: Callable[[RunNow], None]) -> None:
        """Show the run until it ends or stalls."""
        is_done = False
        while not is_done:
            is_done = self._done.wait(_DONE_INTERVAL_S) or self.stream.permit.paused_s > _MAX_PAUSE_S
            for state in self.status.take_instructions():
                self._show(show, state)
            self._show(show, self._now_with_stall())
            if self.waits_when_dark and self.typed_acknowledgement is not None:
                # an OSError comes from a terminal that was closed, where nobody can be asked
                with suppress(OSError):
                    self.typed_acknowledgement.look(self.status.light.alarm)

    def _show(self, show: Callable[[RunNow], None], now: RunNow) -> None:
        self.guard.call("the display", None, show, now)

    def _now_with_stall(self) -> RunNow:
        """The state of the run; a stalled thread cannot say by itself that it has stalled."""
        stalled = self.stream.permit.stalled
        return replace(self.status.now, alarm=stalled) if stalled else self.status.now

    def _process(self) -> None:
        """The processing thread, from the first frame to the closed record."""
        try:
            first = self.stream.begin()
            if first is None:
                raise DataError("the camera delivered no frame at all; nothing was recorded")
            if self.plan.checked is not None:
                self._check()
                return
            first_utc_offset_ns = utc_offset_ns(first)
            number = 1
            while not self._attempt(number, first_utc_offset_ns):
                number += 1
        except Exception as error:
            self.stop.failed(error)
        finally:
            # the main thread must learn that the run has ended, whatever else fails here
            try:
                self._shut_down()
            except Exception as error:
                self.stop.failed(error)
            finally:
                self._done.set()

    def _check(self) -> None:
        """Make the preflight alone; the laser is switched off before the display, which may be slow."""
        try:
            if self.phases is not None:
                self.phases.check_alone(self.stream, self._prepare, self.stop)
        finally:
            self.devices.darken()
        self.stop.request("the checks are made")

    def _attempt(self, number: int, first_utc_offset_ns: int) -> bool:
        """Make one attempt at a start and record it; False if it was rejected and is to be repeated."""
        config = self.plan.config
        frames, events = self._first_frames()
        # computed now, because the computer's clock may be set during an hour of rest and warm-up; frames
        # made on demand are timed by their first frame
        epoch_offset_ns = first_utc_offset_ns if self.stream.policy == "wait" else utc_offset_ns(frames[-1])
        if self.phases is not None:
            self.stream.restart_losses()
        preflight = () if self.phases is None else self.phases.verdicts
        recorder = Recorder(
            self.open_record(epoch_offset_ns, frames[0], preflight),
            # frames made on demand wait for the disk, and no memory has to hold them
            MAX_QUEUE_BYTES // 16 if self.stream.policy == "wait" else MAX_QUEUE_BYTES,
            permit=self.stream.permit,
        )
        # a run that is recorded at once accepts any start
        judge = None if config.start.way == "at once" else StartJudge(config, self.optics.unit)
        try:
            rejection = Recording(self, recorder, judge, frames[0]).record(frames, events)
        finally:
            recorder.close()
            if recorder.error is not None:
                self.stop.failed(recorder.error)
        if not rejection or judge is None or recorder.error is not None:
            return True
        rejected_record = set_aside(self.plan.record, number)
        if self.phases is not None:
            self.phases.correct_starter(judge.first_amplitude)
        self.plan.start_rejected(rejected_record, rejection)
        if number >= judge.attempts:
            raise DataError(f"no start of {number} was accepted; the last: {rejection}")
        return False

    def _first_frames(self) -> tuple[list[Frame], list[Event]]:
        """The frames with which the record begins, at least one, and the events before them."""
        phases, stream = self.phases, self.stream
        if phases is not None:
            frames, events = phases.run(stream, self._prepare, self.stop)
            if not frames:
                why = self.stop.reason or stream.end_reason or "stopped"
                raise stream.failure or DataError(f"{why} before the run began; nothing was recorded")
            return frames, events
        while not (stream.drained or self.stop):
            if frames := stream.take(1, 0.1):
                return frames, []
        raise stream.failure or DataError("stopped before the run began; nothing was recorded")

    def _prepare(self, phase: RecordedPhase) -> None:
        """Publish a state before the record begins; raises DeviceError if the laser is dark."""
        self.status.prepare(phase)
        if self.status.light.alarm:
            raise DeviceError(f"{self.status.light.alarm}; nothing was recorded")

    def _shut_down(self) -> None:
        self.stop.close_stream()
        end = RecordedPhase(0, self.status.now.elapsed_s, Phase.DONE.value, reason=self.stop.reason)
        self.status.tell(RecordContents(messages=[RecordedLosses(0, *self.stream.losses.counts), end]))


def utc_offset_ns(frame: Frame) -> int:
    """UTC minus the frames' clock, by the computer's clock of the day at this moment.

    Raises DeviceError if that clock shows a time before 1970, which a record cannot hold.
    """
    now_ns = time.time_ns()
    if now_ns < 0:
        raise DeviceError("the computer's clock of the day is before 1970; set it, then measure again")
    return now_ns - frame.time_ns - (time.monotonic_ns() - frame.host_time_ns)


MIN_FREE_BYTES = 50 * 1024 * 1024
"""Free disk space below which no run begins."""


def _check_path(record: Path) -> None:
    """Raise ConfigurationError for a record that exists, RecordError where too little disk is free."""
    if record.exists():
        raise ConfigurationError(f"{record}: exists already and is never overwritten; choose another output")
    free = free_bytes(record.parent)
    if free < MIN_FREE_BYTES:
        raise RecordError(
            f"{record.parent}: {free // 2**20} MiB of disk are free, {MIN_FREE_BYTES // 2**20} MiB "
            "are needed to begin; nothing was started: free some, or name another folder"
        )


def measure_run(plan: RunPlan, devices: Devices) -> RunOutcome:
    """Measure one run into one record; camera and view are closed at the end in any case."""
    record = plan.record
    if plan.checked is None:
        _check_path(record)
    if plan.config.simulated:
        _say_if_open(f"{plan.title}: SIMULATED (no camera is read; every number is the simulated rig's)")
    with devices.camera(plan.config) as camera:
        for line in camera.notes:
            _say_if_open(line)
        posterior = live_posterior(plan.config) if plan.fitted else None
        view = RunningView(record, plan.config.view.mode, plan.config.view.layout)
        try:
            outcome = _execute(plan, devices, camera, posterior)
            no_run_follows = plan.is_last or outcome.failure is not None or outcome.stopped
            devices.lights_again = not no_run_follows
            # while a run hangs its light is off already
            if no_run_follows and not outcome.hangs:
                devices.darken(outcome.last.reason or "the run has ended")
            return outcome
        finally:
            if posterior is not None:
                posterior.close()
            view.close()


def _execute(
    plan: RunPlan, devices: Devices, camera: OpenCamera, posterior: LivePosterior | None
) -> RunOutcome:
    config, session_news = plan.config, plan.session_news
    optics = optics_of(config, camera.info.full_scale_dn)
    display = RunDisplay(
        plan.title,
        config.session.final_amplitude_arcsec,
        optics.unit,
        max_duration_s=config.session.max_duration_s,
        stop_when=config.stop_conditions if posterior is not None else (),
        json_lines=plan.json_lines,
        simulated=config.simulated,
        phases=phases_wanted(config) if plan.checked is None else (),
    )
    session_news.begin_run(plan.title, camera.info.full_scale_dn, camera.applied, plan.record)

    def show_table(verdicts: Sequence[Verdict]) -> None:
        (plan.checked or display.show_preflight)(verdicts)
        session_news.preflight(verdicts)

    def show(now: RunNow) -> None:
        try:
            display.show(now)
        finally:
            # also if the display fails
            session_news.state(display.values(now), display.facts(now))

    phases: PhasesBeforeRecord | None = None
    if phases_wanted(config):
        phases = PhasesBeforeRecord(plan, devices, camera, optics, show_table)
    run = MeasurementRun(
        plan=plan,
        camera=camera,
        optics=optics,
        stream=devices.stream(config, camera),
        devices=devices,
        phases=phases,
        watchers=(display, *plan.watchers),
        posterior=posterior,
        typed_acknowledgement=TypedAcknowledgement(devices),
    )
    prepare_kernels(optics.sensor, say)
    decay_summary.prepare()
    # after compiling and importing, which take time: a laser may be lit only while frames are processed
    if light_text := devices.light():
        say(light_text)
    with display:
        return run.execute(show)


def _say_if_open(text: str) -> None:
    """Print a line; a session whose terminal was closed goes on without it."""
    with suppress(OSError):
        say(text)
