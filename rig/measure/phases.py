"""The phases before a record: rest, warm-up, preflight and release, each with a time limit."""

import math
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from acquisition.camera import Frame
from acquisition.record.events import Event, EventKind
from acquisition.record.topics import RecordedPhase
from processing.deflections import DeflectionUnit
from processing.errors import DataError, DeviceError, RecordError
from processing.noise_models import robust_scatter
from processing.units import ARCSEC_RAD, nanoseconds
from rig.control import Controller
from rig.devices import AuditEntry, Devices, FrameStream, OpenCamera, through_controller, wait_for_command
from rig.instrument import Optics, Phase
from rig.measure.end_of_run import StopRequest
from rig.measure.preflight import TrialFrames, frame_checks, rest_checks
from rig.measure.recent_frames import PhaseWait, RecentFrames, WaitStopped
from rig.measure.run_parts import RunPlan
from rig.settings import Configuration
from rig.terminal import Verdict, failures

_MIN_FRAMES_AT_ONCE = 100
"""Fewest frames of the preflight of a run without a rest phase."""
_MIN_FRAMES_AT_REST = 110
"""Fewest frames of the preflight at rest; a few more than noise and spectrum need."""
_MIN_BRAKE_INTERVAL_NS = 2_000_000_000
"""Shortest time between two commands that close the brake."""
_MAX_REST_SPREAD_SIGMA = 6.0
"""Limit of half the range at rest, in standard deviations of one frame; noise alone stays below it."""
_MIN_RELEASE_SIGMA = 8.0
"""Smallest motion that is taken for a release, in standard uncertainties of one deflection."""
_REST_POSITION_NS = 1_000_000_000
"""Time span of which the rest position before a release is the median."""
_FRAMES_MOVED = 2
"""Frames in a row, away from the rest position, that show the release."""


class NoGo(DataError):
    """The preflight says no-go, for the reasons `failed_checks`; a later try may succeed."""

    def __init__(self, failed_checks: str) -> None:
        super().__init__(f"preflight says no-go ({failed_checks}); --force overrides it")
        self.failed_checks = failed_checks


class PhasesBeforeRecord:
    """Runs the phases before the record of a run; `run` is called for every attempt at a start.

    `verdicts` is the preflight table, which `show_table` gets, `starter_pulse_s` the pulse of the next
    attempt.
    """

    def __init__(
        self,
        plan: RunPlan,
        devices: Devices,
        camera: OpenCamera,
        optics: Optics,
        show_table: Callable[[Sequence[Verdict]], None] = lambda _: None,
    ) -> None:
        config = self._config = plan.config
        self._plan, self._devices, self._camera, self._optics = plan, devices, camera, optics
        self._show_table, self._unit = show_table, optics.unit
        self.verdicts: list[Verdict] = []
        self.starter_pulse_s = config.start.starter_pulse_s
        self._attempts = 0
        self._is_warm = False
        if config.start.by_controller:
            # before hours of warm-up and rest, which would be in vain without a controller
            devices.required_control(f"start.way = {config.start.way!r}")

    def run(
        self, stream: FrameStream, report: Callable[[RecordedPhase], None], stop: StopRequest
    ) -> tuple[list[Frame], list[Event]]:
        """Run the phases; returns the frames with which the record begins, and the events so far.

        There are no frames if the run was stopped or the source has ended. Raises RigError with the
        reason if the run must not begin.
        """
        config = self._config
        window_s = max(config.phases.rest_window_s, config.phases.warm_up_window_s, _preflight_s(config))
        # the preflight needs whole frames, not deflections alone
        frames_s = max(config.start.pretrigger_s, _preflight_s(config))
        frames = RecentFrames(stream, self._optics, frames_s, window_s, self._plan.session_news.look)
        self._wait = PhaseWait(frames, report, stop)
        self._attempts += 1
        try:
            if config.start.way == "at once":
                self._preflight()
                return frames.frames, self._wait.events
            self._come_to_rest()
            self._warm_up()
            if self._attempts == 1:
                self._preflight()
            self._release()
        except WaitStopped:
            return [], self._wait.events
        finally:
            self._brake(False)
        first_ns = frames.now_ns - nanoseconds(config.start.pretrigger_s)
        return [frame for frame in frames.frames if frame.time_ns >= first_ns], self._wait.events

    def check_alone(
        self, stream: FrameStream, report: Callable[[RecordedPhase], None], stop: StopRequest
    ) -> None:
        """Make the preflight table of the pendulum as it hangs or swings, without a run; none if stopped."""
        duration_s = _preflight_s(self._config)
        look = self._plan.session_news.look
        frames = RecentFrames(stream, self._optics, duration_s, duration_s, look)
        self._wait = PhaseWait(frames, report, stop)
        with suppress(NoGo, WaitStopped):
            self._preflight()

    def correct_starter(self, first_amplitude: float) -> None:
        """Scale the next starter pulse by the `first_amplitude` of the last; unchanged if that is in px."""
        target_rad = self._config.session.initial_amplitude_arcsec * ARCSEC_RAD
        target_rad *= 0.5 * (self._config.start.lowest_amplitude + self._config.start.highest_amplitude)
        if first_amplitude > 0 and self._unit is DeflectionUnit.RAD:
            factor = min(2.0, max(0.5, target_rad / first_amplitude))
            self.starter_pulse_s = min(self.starter_pulse_s * factor, self._config.controller.starter_max_s)

    def _come_to_rest(self) -> None:
        """Wait until X and Y stay within the limit for a whole window; use the brake if there is one."""
        phases, frames = self._config.phases, self._wait.frames
        window_ns = nanoseconds(phases.rest_window_s)
        brake_due_ns = 0

        def at_rest(elapsed_s: float) -> bool:
            nonlocal brake_due_ns
            recent = frames.since(frames.now_ns - window_ns)
            recent = recent[recent.found]
            if elapsed_s < phases.rest_window_s or len(recent) < 2:
                self._wait.progress = f"{elapsed_s:.0f} of {phases.rest_window_s:g} s"
                return False
            spread = 0.5 * max(np.ptp(recent.shown_x), np.ptp(recent.shown_y))
            limit = phases.rest_limit_arcsec
            if self._unit is DeflectionUnit.PX:
                # the limit is configured in arcsec
                limit = _MAX_REST_SPREAD_SIGMA * max(_frame_noise(recent.x), _frame_noise(recent.y))
            self._wait.progress = f"spread {spread:.2f} {self._unit.shown} (limit {limit:.3g})"
            if spread <= limit:
                return True
            if frames.now_ns >= brake_due_ns and spread > 2 * limit:
                brake_due_ns = frames.now_ns + _MIN_BRAKE_INTERVAL_NS
                self._brake(True)
            elif spread <= 2 * limit:
                self._brake(False)
            return False

        self._wait.until_reached(Phase.REST, phases.rest_max_s, at_rest, every_s=0.2)
        self._brake(False)

    def _warm_up(self) -> None:
        """Wait until the drift of the resting spot is small, if this program switches the laser on."""
        laser, phases, frames = self._config.laser, self._config.phases, self._wait.frames
        if laser.kind == "none" or self._is_warm:
            return
        window_s = phases.warm_up_window_s
        min_s = max(window_s, laser.warm_up_min_s)

        def warm(elapsed_s: float) -> bool:
            if elapsed_s < min_s:
                self._wait.progress = f"{elapsed_s:.0f} of {min_s:g} s"
                return False
            recent = frames.since(frames.now_ns - nanoseconds(window_s))
            drift = max(
                _drift_per_min(recent.times_s, recent.shown_x), _drift_per_min(recent.times_s, recent.shown_y)
            )
            limit = phases.warm_up_drift_arcsec_per_min
            text = f"drift {drift:.2f} {self._unit.shown}/min" if math.isfinite(drift) else "no spot is seen"
            if self._unit is DeflectionUnit.PX:
                self._wait.progress = f"{text}, not checked: {rest_checks.NO_LEVER}"
                return True
            self._wait.progress = f"{text} (limit {limit:.3g})"
            return drift <= limit

        self._wait.until_reached(Phase.WARM_UP, laser.warm_up_max_s, warm, every_s=0.5)
        self._is_warm = True

    def _preflight(self) -> None:
        """Take the frames of the preflight, if it is wanted, and make its table."""
        if not preflight_wanted(self._config):
            return
        resting, duration_s = self._config.start.way != "at once", _preflight_s(self._config)

        def are_enough(elapsed_s: float) -> bool:
            if not resting:
                return self._wait.frames.frames_taken >= _MIN_FRAMES_AT_ONCE
            self._wait.progress = f"{elapsed_s:.0f} of {duration_s:g} s"
            return elapsed_s >= duration_s

        self._wait.until_reached(Phase.PREFLIGHT, math.inf, are_enough)
        self._check(resting)

    def _check(self, resting: bool) -> None:
        """Make the preflight table; raises NoGo if a check fails, unless forced, and DeviceError instead if
        the laser has gone dark, because every check of its light fails then."""
        config, frames = self._config, self._wait.frames
        limits = config.preflight
        trial = frames.trial(resting, _preflight_s(config))
        self.verdicts = [
            frame_checks.camera(self._camera.info.driver, self._camera.notes),
            frame_checks.shutter(
                self._camera.info.shutter, config.shutter, config.axes, pulsed=config.laser.pulse_us > 0
            ),
            *frame_checks.check_trial_frames(
                trial,
                config,
                self._camera.info.full_scale_dn,
                frames.window_bytes(),
                free_bytes(self._plan.record.parent),
            ),
            frame_checks.controller(self._devices.safety(), config.controller.kind != "none"),
            frame_checks.laser(self._devices.laser_report(), through_controller(config.laser)),
            self._seismometer_verdict(trial),
            rest_checks.reference(trial, config.reference, limits),
            frame_checks.air(
                self._devices.environment(),
                config.environment_sensor.kind != "none",
                limits,
                optional=config.environment_sensor.kind == "controller",
            ),
        ]
        failed_checks = failures(self.verdicts)
        if failed_checks:
            self._raise_if_dark()
        self._show_table(self.verdicts)
        self._wait.note(EventKind.PREFLIGHT, f"no-go: {failed_checks}" if failed_checks else "go")
        if failed_checks and not self._plan.force:
            raise NoGo(failed_checks)
        if failed_checks:
            self._devices.audit(AuditEntry.FORCE, f"preflight said no-go: {failed_checks}")

    def _raise_if_dark(self) -> None:
        """Raise DeviceError if the laser that this program has lit is dark, which is then the cause."""
        if self._devices.permit.expects_light and (why := self._devices.reported_darkness()):
            raise DeviceError(f"the laser is dark: {why}; nothing was recorded")

    def _seismometer_verdict(self, trial: TrialFrames) -> Verdict:
        """The verdict on the auxiliary seismometer during these frames."""
        seismometer, config = self._devices.seismometer, self._config
        samples = []
        if seismometer is not None and trial.frames:
            samples = seismometer.recent(trial.frames[-1], _preflight_s(config))
        problem = None if seismometer is None else seismometer.problem
        return rest_checks.seismometer(trial, problem, config.seismometer, samples, config.reference)

    def _release(self) -> None:
        """Release the pendulum or ask the operator to, and wait until it moves."""
        start = self._config.start
        wait = self._wait
        instruction = ""
        rest, threshold = self._rest_position()

        def command(call: Callable[[Controller], object]) -> None:
            wait_for_command(self._devices.required_control(f"start.way = {start.way!r}").submit(call))

        if start.way == "magnet":
            command(lambda controller: controller.hold())
            self._come_to_rest()
            free_rest = rest
            rest, threshold = self._rest_position()
            offset = math.dist(rest, free_rest)
            distance = f"{offset / self._unit.shown_size:.1f} {self._unit.shown}"
            if not offset > threshold:
                raise DataError(
                    f"the magnet does not hold the pendulum: the spot is {distance} "
                    "from its free rest position; check the magnet, its current and its distance"
                )
            wait.note(EventKind.MAGNET, f"holds the pendulum at {distance}")
            command(lambda controller: controller.release())
        elif start.way == "starter":
            command(lambda controller: controller.starter_pulse(self.starter_pulse_s))
            wait.note(EventKind.STARTER, f"pulse of {self.starter_pulse_s:.3f} s")
        else:
            instruction = "release by hand now"
        frames_moved = 0

        def moved(_: float) -> bool:
            nonlocal frames_moved
            frames_moved = frames_moved + 1 if math.dist(wait.frames.newest, rest) > threshold else 0
            return frames_moved >= _FRAMES_MOVED

        wait.until_reached(Phase.RELEASE, self._config.phases.release_max_s, moved, instruction)

    def _rest_position(self) -> tuple[tuple[float, float], float]:
        """Median deflection (x, y) of the last second, and the smallest distance from it above noise."""
        recent = self._wait.frames.since(self._wait.frames.now_ns - _REST_POSITION_NS)
        recent = recent[recent.found]
        if not len(recent):
            self._raise_if_dark()
            raise DataError("release: no spot was found for a second; check the laser and the beam path")
        noise = max(robust_scatter(recent.x), robust_scatter(recent.y), float(np.median(recent.u_y)))
        threshold = _MIN_RELEASE_SIGMA * noise
        if self._unit is DeflectionUnit.RAD:
            threshold = max(self._config.start.trigger_arcsec * ARCSEC_RAD, threshold)
        return (float(np.median(recent.x)), float(np.median(recent.y))), threshold

    def _brake(self, on: bool) -> None:
        control = self._devices.control
        if control is None or self._config.start.way == "at once":
            return
        try:
            wait_for_command(control.submit(lambda controller: controller.brake(on)))
        except DeviceError as error:
            self._wait.note(EventKind.BRAKE, str(error))


def phases_wanted(config: Configuration) -> tuple[Phase, ...]:
    """The phases before the record of a run."""
    preflight = (Phase.PREFLIGHT,) if preflight_wanted(config) else ()
    if config.start.way == "at once":
        return preflight
    warm_up = () if config.laser.kind == "none" else (Phase.WARM_UP,)
    return Phase.REST, *warm_up, *preflight, Phase.RELEASE


def preflight_wanted(config: Configuration) -> bool:
    """Whether the preflight is made; 'auto' omits it if frames come on demand."""
    when = config.preflight.when
    if when == "auto":
        return not config.on_demand
    return when == "always"


def _preflight_s(config: Configuration) -> float:
    """Duration of the preflight at rest: longer with a slow camera, so that its frames suffice."""
    return max(config.preflight.duration_s, _MIN_FRAMES_AT_REST / (config.camera.frame_rate_hz or math.inf))


def _drift_per_min(times_s: np.ndarray, values: np.ndarray) -> float:
    """Absolute slope of a fitted line, per minute; infinite with too few samples."""
    good = np.isfinite(values)
    if good.sum() < 10:
        return math.inf
    return 60.0 * abs(float(np.polyfit(times_s[good] - times_s[good][0], values[good], 1)[0]))


def _frame_noise(values: np.ndarray) -> float:
    """Robust standard deviation of one frame, from differences of successive frames."""
    return robust_scatter(np.diff(values)) / math.sqrt(2.0)


def free_bytes(folder: Path) -> int:
    """Free disk space of a folder in bytes; raises RecordError if the folder no longer exists."""
    try:
        return shutil.disk_usage(folder).free
    except OSError as error:
        raise RecordError(
            f"{folder}: {error.strerror or error}; was it removed or renamed while its session ran? nothing "
            "was recorded: name a folder that stays"
        ) from None
