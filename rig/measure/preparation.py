"""The phases before a record, to the release: each with a time limit and a reason for its end."""

import math
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from acquisition.camera import CameraInfo
from acquisition.frame import Frame
from processing.angle import ARCSEC_RAD
from processing.errors import DataError, DeviceError
from processing.spot import SensorModel, SpotTracker
from rig.devices import Devices, FrameStream, done, goes_dark_by_itself
from rig.instrument import Deflector, Event, Snapshot
from rig.measure import preflight
from rig.measure.phase import PhaseWatch, Stopped
from rig.measure.recent_frames import Lookout
from rig.presentation import Verdict
from rig.settings import Configuration

_AT_ONCE_FRAMES = 100
_BRAKE_AGAIN_NS = 2_000_000_000


class Preparation:
    """What goes before the record of a run; called once for every attempt at a start.

    `verdicts` is the preflight table, `starter_pulse_s` the pulse of the next attempt. With `force` a
    no-go is recorded and passed over.
    """

    def __init__(
        self,
        config: Configuration,
        devices: Devices,
        info: CameraInfo,
        camera_notes: Sequence[str],
        sensor: SensorModel,
        make_deflector: Callable[[tuple[int, int]], Deflector],
        folder: Path,
        *,
        force: bool = False,
        show_table: Callable[[Sequence[Verdict]], None] = lambda _: None,
    ) -> None:
        self._config = config
        self._devices = devices
        self._info = info
        self._camera_notes = camera_notes
        self._sensor = sensor
        self._make_deflector = make_deflector
        self._folder = folder
        self._force = force
        self._show_table = show_table
        self._unit_rad = ARCSEC_RAD if config.lever is not None else 1.0
        self._unit = "arcsec" if config.lever is not None else "px"
        self.verdicts: list[Verdict] = []
        self.starter_pulse_s = config.start.starter_pulse_s
        self._attempt = 0
        self._warm = False

    def __call__(
        self, frames: FrameStream, report: Callable[[Snapshot], None], stopped: Callable[[], bool]
    ) -> tuple[list[Frame], list[Event]]:
        """As `rig.run.Prelude`."""
        config = self._config
        window_s = max(
            config.phases.rest_window_s, config.phases.warm_up_window_s, config.preflight.duration_s
        )
        # the look for the preflight needs its frames too
        kept_s = max(config.start.pretrigger_s, config.preflight.duration_s)
        lookout = Lookout(frames, SpotTracker(self._sensor), self._make_deflector, kept_s, window_s)
        self._watch = PhaseWatch(lookout, report, stopped, self._unit_rad)
        self._attempt += 1
        try:
            if config.start.way == "at once":
                self._watch.phase("preflight", math.inf, lambda: lookout.seen >= _AT_ONCE_FRAMES)
                self._check(resting=False)
                return lookout.frames, self._watch.events
            self._come_to_rest()
            self._warm_up()
            if self._attempt == 1:
                self._look()
            self._release()
        except Stopped:
            return [], self._watch.events
        finally:
            self._brake(False)
        kept_from_ns = lookout.now_ns - round(1e9 * config.start.pretrigger_s)
        return [frame for frame in lookout.frames if frame.time_ns >= kept_from_ns], self._watch.events

    def learn(self, first_amplitude_rad: float) -> None:
        """Correct the next starter pulse by what the last one gave."""
        wanted = self._config.session.initial_amplitude_arcsec * self._unit_rad
        wanted *= 0.5 * (self._config.start.lowest_amplitude + self._config.start.highest_amplitude)
        if first_amplitude_rad > 0:
            factor = min(2.0, max(0.5, wanted / first_amplitude_rad))
            self.starter_pulse_s = min(self.starter_pulse_s * factor, self._config.controller.starter_max_s)

    def _come_to_rest(self) -> None:
        """Wait until X and Y stay within the limit for a whole window, with the brake where there is one."""
        phases = self._config.phases
        window_ns = round(phases.rest_window_s * 1e9)
        braked_ns = -_BRAKE_AGAIN_NS
        begun_ns = 0

        def at_rest() -> bool:
            nonlocal braked_ns, begun_ns
            lookout = self._watch.lookout
            begun_ns = begun_ns or lookout.now_ns
            _, x, y = lookout.since(lookout.now_ns - window_ns)
            good = np.isfinite(x) & np.isfinite(y)
            if lookout.now_ns - begun_ns < window_ns or not good.any():
                return False
            spread = 0.5 * max(np.ptp(x[good]), np.ptp(y[good])) / self._unit_rad
            self._watch.words = f"spread {spread:.2f} {self._unit} of {phases.rest_limit_arcsec:g}"
            if spread <= phases.rest_limit_arcsec:
                return True
            if lookout.now_ns - braked_ns >= _BRAKE_AGAIN_NS and spread > 2 * phases.rest_limit_arcsec:
                braked_ns = lookout.now_ns
                self._brake(True)
            elif spread <= 2 * phases.rest_limit_arcsec:
                self._brake(False)
            return False

        self._watch.phase("rest", phases.rest_max_s, at_rest, every_s=0.2)
        self._brake(False)

    def _warm_up(self) -> None:
        """Until the resting spot's drift is below the limit; only where the laser is ours."""
        laser, phases = self._config.laser, self._config.phases
        if laser.kind == "none" or self._warm:
            return
        window_ns = round(phases.warm_up_window_s * 1e9)
        begun_ns = self._watch.lookout.now_ns

        def warm() -> bool:
            lookout = self._watch.lookout
            since_ns = lookout.now_ns - begun_ns
            if since_ns < max(window_ns, laser.warm_up_min_s * 1e9):
                return False
            times_s, x, y = lookout.since(lookout.now_ns - window_ns)
            drift = max(_drift_per_min(times_s, x), _drift_per_min(times_s, y)) / self._unit_rad
            self._watch.words = f"drift {drift:.2f} {self._unit}/min"
            return drift <= phases.warm_up_drift_arcsec_per_min

        self._watch.phase("warm-up", laser.warm_up_max_s, warm, every_s=0.5)
        self._warm = True

    def _look(self) -> None:
        if not preflight_wanted(self._config):
            return
        begun_ns = self._watch.lookout.now_ns
        duration_ns = round(self._config.preflight.duration_s * 1e9)
        self._watch.phase("preflight", math.inf, lambda: self._watch.lookout.now_ns - begun_ns >= duration_ns)
        self._check(resting=True)

    def _check(self, resting: bool) -> None:
        """The go / no-go table; raises DataError for a no-go that is not forced."""
        if not preflight_wanted(self._config):
            return
        config, lookout = self._config, self._watch.lookout
        limits = config.preflight
        self.verdicts = [
            preflight.camera(self._info.driver, self._camera_notes),
            *preflight.check_look(
                lookout.look(resting, limits.duration_s),
                config,
                self._info.full_scale_dn,
                lookout.window_bytes(),
                shutil.disk_usage(self._folder).free,
            ),
            preflight.controller(self._devices.describe(), config.controller.kind != "none"),
            preflight.laser(self._devices.laser_now(), goes_dark_by_itself(config.laser)),
            preflight.air(self._devices.environment(), config.environment_sensor.kind != "none", limits),
        ]
        self._show_table(self.verdicts)
        against = preflight.failures(self.verdicts)
        self._watch.note("preflight", f"no-go: {against}" if against else "go")
        if against and not self._force:
            raise DataError(f"preflight says no-go ({against}); --force passes over it")

    def _release(self) -> None:
        """Let go, or ask for it, and see it happen."""
        start = self._config.start
        who = f"start.way = {start.way!r}"
        watch = self._watch
        instruction = ""
        rest, threshold = self._place()
        if start.way == "magnet":
            done(self._devices.required_control(who).hold())
            self._come_to_rest()
            free = rest
            rest, threshold = self._place()
            held = math.hypot(rest[0] - free[0], rest[1] - free[1])
            if not held > threshold:
                raise DataError(
                    f"the magnet holds nothing: the spot is {held / self._unit_rad:.1f} {self._unit} "
                    "from where it rests freely; see the magnet, its current and its distance"
                )
            watch.note("magnet", f"holds the pendulum at {held / self._unit_rad:.1f} {self._unit}")
            done(self._devices.required_control(who).release())
        elif start.way == "starter":
            done(self._devices.required_control(who).starter_pulse(self.starter_pulse_s))
            watch.note("starter", f"pulse of {self.starter_pulse_s:.3f} s")
        else:
            instruction = "release by hand now"
        in_a_row = 0

        def moved() -> bool:
            nonlocal in_a_row
            x_now, y_now = watch.lookout.newest
            far = math.hypot(x_now - rest[0], y_now - rest[1]) > threshold
            in_a_row = in_a_row + 1 if far else 0
            return in_a_row >= 2

        watch.phase("release", self._config.phases.release_max_s, moved, instruction)

    def _place(self) -> tuple[tuple[float, float], float]:
        """Where the spot stands, of the last second, and how far from there is no noise any more."""
        _, x, y = self._watch.lookout.since(self._watch.lookout.now_ns - 1_000_000_000)
        noise = max(_scatter(x), _scatter(y))
        threshold = max(self._config.start.trigger_arcsec * self._unit_rad, 8.0 * noise)
        return (float(np.nanmedian(x)), float(np.nanmedian(y))), threshold

    def _brake(self, on: bool) -> None:
        control = self._devices.control
        if control is None or self._config.start.way == "at once":
            return
        try:
            done(control.brake(on))
        except DeviceError as error:
            self._watch.note("brake", str(error))


def preflight_wanted(config: Configuration) -> bool:
    """'auto' spares frames that are made on demand: there is nothing to check and nobody to wait."""
    when = config.preflight.when
    if when == "auto":
        on_demand = config.camera.driver == "files" or (
            config.camera.driver == "simulated" and not config.simulation.real_time
        )
        return not on_demand
    return when == "always"


def _drift_per_min(times_s: np.ndarray, values: np.ndarray) -> float:
    """Slope of a line, per minute, without its sign; infinite without enough samples."""
    good = np.isfinite(values)
    if good.sum() < 10:
        return math.inf
    return 60.0 * abs(float(np.polyfit(times_s[good] - times_s[good][0], values[good], 1)[0]))


def _scatter(values: np.ndarray) -> float:
    """Robust standard deviation."""
    good = values[np.isfinite(values)]
    return 1.4826 * float(np.median(np.abs(good - np.median(good)))) if len(good) else 0.0
