"""A record, or a preflight, without a session."""

import queue
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
from rich.console import Console

from acquisition import atomic_write
from acquisition.record.topics import RecordedPhase
from processing.errors import ConfigurationError, DataError, DeviceError, RecordError
from rig.devices import Devices, LightWatch, ask_leave
from rig.instrument import (
    check_materials,
    complete,
    optics_of,
    prepare_kernels,
)
from rig.measure.end_of_run import StopRequest
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.run_parts import RunPlan
from rig.measure.run_setup import measure_run
from rig.orders import SessionNews, light_told
from rig.presentation import Verdict, failures, print_json_line, print_verdicts, say, table_tree
from rig.settings import Configuration

_NO_END = 1e-9
"""Amplitude in arcsec at which a record would end: a clamped pendulum has none."""


def record_plainly(config: Configuration, source: Path, record: Path, seconds: float) -> Path:
    """Record the spot for a time, whatever it does; returns the record.

    Meanwhile its folder's order socket tells how it looks. One that goes dark ends.

    Raises RigError where that fails, KeyboardInterrupt after Ctrl-C, which leaves a closed record.
    """
    updates = {
        "session": config.session.model_copy(
            update={"max_duration_s": seconds, "final_amplitude_arcsec": _NO_END, "stop_when": ()}
        ),
        "view": config.view.model_copy(update={"mode": "none", "file": False}),
        "preflight": config.preflight.model_copy(update={"when": "never"}),
        "start": config.start.model_copy(update={"way": "at once"}),
        # whoever looks at the picture gives no leave to go on
        "laser": config.laser.model_copy(update={"when_dark": "end"}),
    }
    record.parent.mkdir(parents=True, exist_ok=True)
    config = complete(config.model_copy(update=updates))
    folder, session_news = record.parent, SessionNews(config)
    with (
        Devices(config, folder, "a recording for a calibration") as devices,
        light_told(devices, config, folder, session_news),
    ):
        ask_leave(devices)
        plan = RunPlan(config, source, record, record.stem, fitted=False, session_news=session_news)
        outcome = measure_run(plan, devices)
    if outcome.failure is not None:
        raise outcome.failure
    if outcome.interrupt is not None:
        raise outcome.interrupt
    return record


def take_frames(config: Configuration, folder: Path, count: int) -> Path:
    """Save whole frames as PNG, with every bit, into a new folder; the laser stays as it is.

    Raises ConfigurationError for a folder that exists, DataError if the camera gives too few frames.
    """
    if folder.exists():
        raise ConfigurationError(f"{folder}: exists already and is not overwritten; choose another folder")
    with Devices(config).camera(config) as opened:
        opened.camera.start()
        try:
            frames = [opened.camera.read(config.camera.patience_s) for _ in range(count)]
        finally:
            opened.camera.stop()
    images = [frame.image for frame in frames if frame is not None]
    if len(images) < count:
        raise DataError(f"the camera gave {len(images)} frames, {count} were asked for")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write.folder_being_written(folder) as beside:
            for number, image in enumerate(images):
                done, png = cv2.imencode(".png", image)
                if not done:
                    raise DataError(f"{folder / f'{number:03d}.png'}: cannot be written as PNG")
                (beside / f"{number:03d}.png").write_bytes(png.tobytes())
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return folder


def preflight_rig(config: Configuration, *, json_lines: bool = False) -> int:
    """Light the laser, look at the spot, print the table of checks; returns exit status 1 for no-go.

    Nothing is moved and nothing is recorded. Noise, rest position and ground are judged if a run would begin
    at rest (start.way is not 'at once'): the pendulum must rest then.
    """
    preflight = config.preflight.model_copy(update={"when": "always"})
    config = complete(config.model_copy(update={"preflight": preflight}))
    check_materials(config)
    folder = config.session.output
    with (
        Devices(config, folder, "rig doctor --preflight") as devices,
        light_told(devices, config, folder),
        devices.camera(config) as camera,
    ):
        optics = optics_of(config, camera.info.full_scale_dn)
        phases = PhasesBeforeRecord(config, devices, camera, optics, _place(config))
        stream = devices.stream(config, camera)
        prepare_kernels(optics.sensor, say)
        ask_leave(devices)
        if lit := devices.light():
            say(lit)
        light = LightWatch(devices)
        before = ("", "")
        states: queue.SimpleQueue[RecordedPhase | None] = queue.SimpleQueue()

        def report(phase: RecordedPhase) -> None:
            nonlocal before
            light.look()
            if light.alarm:
                raise DeviceError(light.alarm)
            doing = phase.phase, phase.progress
            if doing != before:
                states.put(phase)
            before = doing

        def look(stop: StopRequest) -> list[Verdict]:
            try:
                stream.start_camera()
                if stream.begin() is None:
                    raise DataError("the camera delivered no frame at all")
                return phases.check_alone(stream, report, stop)
            finally:
                devices.darken()
                stream.close()
                states.put(None)

        # in a thread of its own: what is printed may wait for a reader, and frames may not
        stop = StopRequest(stream)
        with ThreadPoolExecutor(1, "preflight") as looking:
            found = looking.submit(look, stop)
            try:
                while (state := states.get()) is not None:
                    if json_lines:
                        where = {"phase": state.phase, "progress": state.progress}
                        print_json_line("state", {**where, "elapsed_s": state.elapsed_s})
            finally:
                stop.because("stopped")
            verdicts = found.result()
    if json_lines:
        print_json_line("preflight", {"table": table_tree(verdicts)})
    else:
        print_verdicts(Console(), verdicts)
    against = failures(verdicts)
    if against:
        say(f"no-go: {against}")
    return 1 if against or not verdicts else 0


def _place(config: Configuration) -> Path:
    """Where a record would be written, as far as it exists."""
    place = config.session.output.absolute()
    while not place.exists():
        place = place.parent
    return place
