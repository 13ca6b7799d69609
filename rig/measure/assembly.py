"""One run of a session: devices, phases, record, view and terminal put together."""

import errno
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.frame import Frame
from acquisition.record.writer import RecordWriter
from calibration.axes import Axes
from processing.angle import ARCSEC_RAD
from processing.errors import ConfigurationError
from processing.spot import SpotTracker
from rig.devices import Devices, OpenCamera
from rig.instrument import (
    Deflector,
    Pipeline,
    camera_settings,
    configuration_attachments,
    frame_policy,
    prepare_kernels,
    sensor_model,
    session_metadata,
)
from rig.measure.preflight import table_tree
from rig.measure.preparation import Preparation, preflight_wanted
from rig.measure.roles import Attempts, RunOutcome, Watcher
from rig.measure.run import Run
from rig.measure.screen import RunDisplay
from rig.measure.start_and_end import EndOfRun, StartJudge
from rig.presentation import Verdict, print_preflight, say
from rig.settings import Configuration
from rig.view import LiveView, open_view

_RESERVE_BYTES = 50 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class RunPlan:
    """One run to be made. `set_aside` is called with the new name of each record whose start failed."""

    config: Configuration
    source: Path
    record: Path
    title: str
    force: bool = False
    json_lines: bool = False
    set_aside: Callable[[Path, str], None] = lambda _path, _reason: None


def measure_run(plan: RunPlan, devices: Devices) -> RunOutcome:
    """One run into one record; camera and view are closed whatever happens."""
    record = plan.record
    if record.exists():
        raise ConfigurationError(f"{record}: exists already and is never overwritten; choose another output")
    free_bytes = shutil.disk_usage(record.parent).free
    if free_bytes < _RESERVE_BYTES:
        raise OSError(errno.ENOSPC, f"{record.parent}: {free_bytes // 2**20} MiB free; nothing was started")
    with devices.camera(plan.config) as camera:
        for line in camera.notes:
            say(line)
        view = open_view(plan.config, record, plan.title, camera.info.full_scale_dn)
        try:
            return _execute(plan, devices, camera, view)
        finally:
            if view is not None:
                for note in view.close().notes:
                    say(f"view: {note}")


def start_judge(config: Configuration, unit_rad: float) -> StartJudge:
    """The judge of a start as the configuration asks for it."""
    wanted = config.session.initial_amplitude_arcsec * unit_rad
    start = config.start
    return StartJudge(
        start.lowest_amplitude * wanted,
        start.highest_amplitude * wanted,
        start.max_transverse_ratio,
        start.patience_s,
        unit_rad,
    )


def _execute(plan: RunPlan, devices: Devices, camera: OpenCamera, view: LiveView | None) -> RunOutcome:
    config, record = plan.config, plan.record
    sensor = sensor_model(config, camera.info.full_scale_dn)
    calibrated = config.lever is not None
    unit_rad = ARCSEC_RAD if calibrated else 1.0
    axes = config.axes or Axes()
    display = RunDisplay(
        plan.title,
        config.session.final_amplitude_arcsec,
        "arcsec" if calibrated else "px",
        unit_rad,
        record.parent,
        json_lines=plan.json_lines,
    )

    def show_table(verdicts: Sequence[Verdict]) -> None:
        if plan.json_lines:
            display.line("preflight", {"table": table_tree(verdicts)})
        else:
            display.above(lambda console: print_preflight(console, verdicts))

    preparation = Preparation(
        config,
        devices,
        camera.info,
        camera.notes,
        sensor,
        lambda shape: Deflector(config.lever, axes, shape),
        record.parent,
        force=plan.force,
        show_table=show_table,
    )

    def make_pipeline(sensor_shape: tuple[int, int]) -> Pipeline:
        return Pipeline(SpotTracker(sensor), config.lever, axes, sensor_shape)

    def open_writer(epoch_offset_ns: int, first: Frame) -> RecordWriter:
        attachments = configuration_attachments(config, plan.source)
        if preparation.verdicts:
            attachments["preflight.json"] = json.dumps(table_tree(preparation.verdicts), indent=1).encode()
        writer = RecordWriter(
            record,
            epoch_offset_ns,
            metadata=session_metadata(config, camera.info, first),
            attachments=attachments,
            deflection_unit="rad" if calibrated else "px",
        )
        if config.lever is not None:
            shape = (first.image.shape[0], first.image.shape[1])
            distance_px = config.lever.arm_m / config.lever.pixel_pitch_m
            reference_px = Deflector(config.lever, axes, shape).reference_px
            writer.write_camera_calibration(first.time_ns, shape, distance_px, reference_px)
        return writer

    judges: list[StartJudge] = []

    def make_judge() -> StartJudge:
        judges.append(start_judge(config, unit_rad))
        return judges[-1]

    def set_aside(number: int, reason: str) -> None:
        aside = record.with_name(f"{record.stem}-start-{number}{record.suffix}")
        record.rename(aside)
        preparation.learn(judges[-1].first_amplitude)
        plan.set_aside(aside, reason)

    prepare_kernels(sensor, say)
    prepared = config.start.way != "at once"
    watchers: list[Watcher] = [display] if view is None else [display, view]
    run = Run(
        camera.camera,
        camera_settings(config),
        make_pipeline,
        open_writer,
        EndOfRun(
            config.session.final_amplitude_arcsec * unit_rad if calibrated else 0.0,
            config.session.max_duration_s,
        ),
        amplitude_unit_rad=unit_rad,
        policy=frame_policy(config),
        timeout_s=config.camera.timeout_s,
        full_frame_interval_s=config.record.full_frame_interval_s,
        keep_windows=config.record.windows,
        watchers=watchers,
        prelude=preparation if prepared or preflight_wanted(config) else None,
        attempts=Attempts(config.start.attempts, make_judge, set_aside) if prepared else None,
        surroundings=devices,
        environment_period_s=config.environment_sensor.period_s,
    )
    with display:
        return run.execute(display.show)
