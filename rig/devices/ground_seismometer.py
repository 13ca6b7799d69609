"""The auxiliary seismometer of a session, with its samples on the clock of the frames."""

import math
import time
from abc import ABC, abstractmethod
from typing import Self

from acquisition.camera import Camera, Frame
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.record.topics import RecordedSeismometer
from acquisition.simulation.ground import SimulatedSeismometer
from acquisition.simulation.settings import SimulationSettings
from processing.errors import ConfigurationError, RigError
from processing.units import nanoseconds, seconds
from rig.control import SeismometerReader, SeismometerSettings
from rig.settings import Configuration
from rig.terminal import Verdict

_POLL_INTERVAL_S = 0.02


class GroundSeismometer(ABC):
    """An auxiliary seismometer, sampled together with a camera's frames; a context manager."""

    def __init__(self) -> None:
        self._recent_samples: list[RecordedSeismometer] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        return None

    def relate_to(self, camera: Camera) -> None:
        """Relate the samples to the clock of a camera, if its frames do not state their arrival."""
        return

    def take(self, frame: Frame) -> list[RecordedSeismometer]:
        """Samples since the last call, up to a frame. Never blocks."""
        recent, self._recent_samples = self._recent_samples, []
        return [*recent, *self._new(frame)]

    def recent(self, frame: Frame, last_s: float) -> list[RecordedSeismometer]:
        """Samples of the last seconds before a frame, which `take` returns again; older are dropped."""
        from_ns = frame.time_ns - nanoseconds(last_s)
        self._recent_samples = [sample for sample in self.take(frame) if sample.time_ns >= from_ns]
        return list(self._recent_samples)

    @abstractmethod
    def _new(self, frame: Frame) -> list[RecordedSeismometer]:
        """Samples that have come since the last call."""

    def take_events(self) -> tuple[str, ...]:
        """Events of the instrument since the last call."""
        return ()

    @property
    def problem(self) -> str:
        """The reason why no samples come; empty while they come."""
        return ""


def make_seismometer(config: Configuration) -> GroundSeismometer | None:
    """The configured auxiliary seismometer; None if none is configured.

    Raises ConfigurationError for one that does not fit the camera.
    """
    settings = config.seismometer
    if settings.kind == "none":
        return None
    if settings.kind == "simulated":
        if not config.simulated:
            raise ConfigurationError(
                f"seismometer.kind = 'simulated' needs the simulated rig, but camera.driver = "
                f"{config.camera.driver!r}: set serial or none"
            )
        return _SimulatedSeismometer(config.simulation)
    if config.on_demand:
        raise ConfigurationError(
            f"seismometer.kind = {settings.kind!r} samples in real time, but the frames come on demand: set "
            "simulation.real_time = true, or 'simulated'"
        )
    return _ConnectedSeismometer(settings)


def check_seismometer(config: Configuration) -> Verdict:
    """Verdict for `rig doctor`; it waits for the first sample for at most `stale_after_s`."""
    kind = config.seismometer.kind
    if kind == "none":
        return Verdict("seismometer", True, "none is configured", made=False)
    try:
        seismometer = make_seismometer(config)
        assert seismometer is not None
        with seismometer:
            deadline_s = time.monotonic() + config.seismometer.stale_after_s
            while seismometer.problem and time.monotonic() < deadline_s:
                time.sleep(_POLL_INTERVAL_S)
            problem = "; ".join(
                dict.fromkeys([*filter(None, [seismometer.problem]), *seismometer.take_events()])
            )
            has_samples = not seismometer.problem
    except RigError as error:
        return Verdict("seismometer", False, str(error), "see [seismometer]")
    remedy = "" if has_samples else "see [seismometer]: its port, rate and columns"
    return Verdict("seismometer", has_samples, f"{kind}, samples come" if has_samples else problem, remedy)


class _ConnectedSeismometer(GroundSeismometer):
    """An instrument on this computer, whose monotonic clock a frame relates to the frames' clock."""

    def __init__(self, settings: SeismometerSettings) -> None:
        super().__init__()
        self._settings = settings
        self._service = SeismometerReader(settings)

    def __enter__(self) -> Self:
        self._service.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._service.close()

    def _new(self, frame: Frame) -> list[RecordedSeismometer]:
        shift_ns = frame.time_ns - frame.host_time_ns
        return [
            RecordedSeismometer(
                sample.host_time_ns + shift_ns, sample.host_time_ns, sample.own_time_s, *sample.components
            )
            for sample in self._service.take_samples()
        ]

    def take_events(self) -> tuple[str, ...]:
        return self._service.take_events()

    @property
    def problem(self) -> str:
        service = self._service
        if not service.stale:
            return ""
        if service.lines_without_reading:
            count = len(self._settings.columns)
            return f"{service.last_line!r} does not hold {count} numbers, for {list(self._settings.columns)}"
        age_s = service.age_s
        return "no line has come" if math.isinf(age_s) else f"no sample for {age_s:.0f} s"


class _SimulatedSeismometer(GroundSeismometer):
    """The auxiliary seismometer of the simulated rig, on the clock of the simulated camera."""

    def __init__(self, settings: SimulationSettings) -> None:
        super().__init__()
        self._settings = settings
        self._seismometer = SimulatedSeismometer(settings)
        self._camera: SimulatedCamera | None = None

    def relate_to(self, camera: Camera) -> None:
        self._camera = camera if isinstance(camera, SimulatedCamera) else None

    def _new(self, frame: Frame) -> list[RecordedSeismometer]:
        if self._camera is None:
            return []
        clock = self._settings.clock
        rate = 1 + 1e-6 * clock.drift_ppm
        readings = self._seismometer.until((seconds(frame.time_ns) - clock.start_s) / rate, self._camera.run)
        times_ns = nanoseconds(clock.start_s + rate * readings.time_s)
        return [
            RecordedSeismometer(time_ns, frame.host_time_ns, math.nan, *counts)
            for time_ns, counts in zip(times_ns.tolist(), readings.counts.tolist(), strict=True)
        ]
