"""The command `rig doctor --preflight`: the checks that precede a run, without the run."""

import queue
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from rich.console import Console

from acquisition.record.topics import RecordedPhase
from processing.errors import DataError, DeviceError
from rig.devices import Devices, LightWatch, ask_leave
from rig.instrument import (
    check_materials,
    complete,
    optics_of,
    prepare_kernels,
)
from rig.measure.end_of_run import StopRequest
from rig.measure.phases import PhasesBeforeRecord
from rig.orders import light_told
from rig.presentation import Verdict, failures, print_json_line, print_verdicts, say, table_tree
from rig.settings import Configuration


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
