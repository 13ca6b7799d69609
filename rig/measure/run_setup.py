"""Sets up camera, phases, record, view and display for one run of a session, and executes it."""

from collections.abc import Sequence
from contextlib import suppress

from processing import decay_summary
from processing.errors import ConfigurationError, RecordError
from rig.devices import Devices, OpenCamera, TypedAcknowledgement
from rig.instrument import RunNow, optics_of, prepare_kernels
from rig.measure.phases import PhasesBeforeRecord, free_bytes, phases_wanted
from rig.measure.posterior import LivePosterior, live_posterior
from rig.measure.run import MeasurementRun
from rig.measure.run_parts import RunOutcome, RunParts, RunPlan
from rig.measure.screen import RunDisplay
from rig.presentation import Verdict, say
from rig.view import RunningView

LEAST_FREE_BYTES = 50 * 1024 * 1024
"""Of disk; with less no run begins."""


def measure_run(plan: RunPlan, devices: Devices) -> RunOutcome:
    """Measure one run into one record; camera and view are closed in any case."""
    record = plan.record
    if record.exists():
        raise ConfigurationError(f"{record}: exists already and is never overwritten; choose another output")
    free = free_bytes(record.parent)
    if free < LEAST_FREE_BYTES:
        raise RecordError(
            f"{record.parent}: {free // 2**20} MiB of disk are free, {LEAST_FREE_BYTES // 2**20} MiB "
            "are needed to begin; nothing was started: free some, or name another folder"
        )
    if plan.config.simulated:
        _say_if_heard(f"{plan.title}: SIMULATED (no camera is read; every number is the simulated rig's)")
    with devices.camera(plan.config) as camera:
        for line in camera.notes:
            _say_if_heard(line)
        posterior = live_posterior(plan.config) if plan.fitted else None
        settings = plan.config.view
        rrd = record.with_suffix(".rrd") if settings.file else None
        view = RunningView(record, settings.mode, rrd, settings.layout)
        try:
            outcome = _execute(plan, devices, camera, posterior)
            ends = plan.is_last or outcome.failure is not None or outcome.stopped
            # what hangs is not asked for frames once more
            devices.lights_again = not ends
            if ends and not outcome.hangs:
                devices.darken(outcome.last.reason or "the run has ended")
            return outcome
        finally:
            if posterior is not None:
                posterior.close()
            if problem := view.close():
                _say_if_heard(problem)


def _execute(
    plan: RunPlan,
    devices: Devices,
    camera: OpenCamera,
    posterior: LivePosterior | None,
) -> RunOutcome:
    config, record = plan.config, plan.record
    optics = optics_of(config, camera.info.full_scale_dn)
    display = RunDisplay(
        plan.title,
        config.session.final_amplitude_arcsec,
        optics.unit,
        longest_s=config.session.max_duration_s,
        stop_when=config.stop_conditions if posterior is not None else (),
        json_lines=plan.json_lines,
        simulated=config.simulated,
        phases=phases_wanted(config),
    )
    session_news = plan.session_news
    if session_news is not None:
        session_news.begin_run(plan.title, camera.info.full_scale_dn, camera.applied, record)

    def show_table(verdicts: Sequence[Verdict]) -> None:
        display.show_preflight(verdicts)
        if session_news is not None:
            session_news.preflight(verdicts)

    def show(now: RunNow) -> None:
        try:
            display.show(now)
        finally:
            # also without a terminal
            if session_news is not None:
                session_news.state(display.values(now), display.facts(now))

    phases: PhasesBeforeRecord | None = None
    if phases_wanted(config):
        phases = PhasesBeforeRecord(
            config,
            devices,
            camera,
            optics,
            record.parent,
            force=plan.force,
            show_table=show_table,
            watch=None if session_news is None else session_news.before_record,
        )
    parts = RunParts(
        plan=plan,
        camera=camera,
        optics=optics,
        stream=devices.stream(config, camera),
        devices=devices,
        phases=phases,
        watchers=(display, *plan.watchers),
        posterior=posterior,
        typed_leave=TypedAcknowledgement(devices),
    )
    prepare_kernels(optics.sensor, say)
    decay_summary.prepare()
    # only now: compiling and importing take time, and a laser may be lit only while frames are processed
    if lit := devices.light():
        say(lit)
    with display:
        return MeasurementRun(parts).execute(show)


def _say_if_heard(text: str) -> None:
    """A session whose terminal was closed goes on without it."""
    with suppress(OSError):
        say(text)
