"""One measurement of the balance over some periods, and the view that shows all measurements."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from acquisition.camera import CameraInfo
from acquisition.frame import Frame
from acquisition.record.events import Event, EventKind
from processing.balance import Balance
from processing.deflections import Deflections
from processing.errors import ConfigurationError, DataError, DeviceError
from processing.spot import SpotFlag
from processing.units import nanoseconds, seconds
from rig.balance.learned_turns import BalanceMeasurement
from rig.devices import Devices, LightWatch, ask_leave, wait_for_command
from rig.instrument import (
    Block,
    configuration_attachments,
    optics_of,
    prepare_kernels,
    session_metadata,
)
from rig.presentation import say
from rig.settings import Configuration
from rig.view import ScratchHead, ScratchView

_UNSEEN = SpotFlag.LOST | SpotFlag.EDGE
_PAUSE_NS = 2_000_000_000
_SHORTEST_PULSE_S = 0.01


class LooksView:
    """The balancing layout, in which the measurements of a session follow each other in time.

    A context manager. The view is opened at the first frame, if a live view or a Rerun file is wanted.
    At the end RecordError is raised where that file is not whole.
    """

    def __init__(
        self,
        config: Configuration,
        rrd: Path | None,
        advise: Callable[[Balance], str],
        way: Callable[[Deflections], None],
    ) -> None:
        self._config = config
        self._rrd = rrd
        self._advise = advise
        self._way = way
        self._view: ScratchView | None = None
        self._shift_ns = 0
        self._shown_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._view is not None:
            self._view.__exit__(kind, error, trace)

    def begin(self, first: Frame, info: CameraInfo) -> None:
        """Begin a measurement; the frames' clock may have been reset."""
        mode = self._config.view.mode
        if mode == "none" and self._rrd is None:
            return
        if self._view is None:
            config = self._config
            self._view = ScratchView("balancing", mode, self._rrd, "balancing")
            metadata = session_metadata(config, info, first)
            attachments = configuration_attachments(config, Path())
            self._view.begin(0, ScratchHead(metadata, attachments, config.deflection_unit))
            self._view.event(Event(0, EventKind.START, "first frame"))
        else:
            self._shown_ns += _PAUSE_NS
            self._view.jump(self._shown_ns, f"restarted at {seconds(self._shown_ns):.1f} s")
        self._shift_ns = first.time_ns - self._shown_ns

    def block(self, frames: Sequence[Frame], block: Block) -> None:
        """Show processed frames."""
        self._way(block.deflections)
        if self._view is not None and frames:
            self._view.block(block, frames, self._shift_ns)
            for balance in block.balances:
                at_ns = balance.time_ns - self._shift_ns
                self._view.event(Event(at_ns, EventKind.ADVICE, self._advise(balance)))
            self._shown_ns = frames[-1].time_ns - self._shift_ns


def look(
    config: Configuration,
    devices: Devices,
    show: Callable[[Balance], None],
    view: LooksView,
    swing_arcsec: float = math.inf,
) -> BalanceMeasurement:
    """Measure the balance over some periods; `show` is called with each balance.

    A starter or a magnet that starts the runs starts this swing too, the starter with `swing_arcsec` at most.
    Raises DataError without frames, DeviceError if the laser goes dark or the camera fails.
    """
    if config.lever is None:
        raise ConfigurationError("rig balance needs [lever], because its limits are in arcsec")
    found: Balance | None = None
    with devices.camera(config) as camera:
        optics = optics_of(config, camera.info.full_scale_dn)
        prepare_kernels(optics.sensor, say)
        # lit only while frames are taken: then the operator's hands may be at the pendulum
        ask_leave(devices)
        if lit := devices.light():
            say(lit)
        stream = devices.stream(config, camera)
        light = LightWatch(devices)
        try:
            stream.start_camera()
            first = stream.begin()
            if first is None:
                raise DataError("the camera delivered no frame at all")
            shape = (first.image.shape[0], first.image.shape[1])
            pipeline = optics.pipeline(shape)
            view.begin(first, camera.info)
            lost = taken = 0
            begin_ns = first.time_ns + nanoseconds(_released_after_s(config, devices, swing_arcsec))
            end_ns = begin_ns + nanoseconds(config.balance.seconds)
            held = begin_ns > first.time_ns
            while not stream.drained:
                frames = stream.take(32, 0.1)
                light.look()
                if light.alarm:
                    raise DeviceError(light.alarm)
                if held and frames and frames[-1].time_ns >= begin_ns:
                    wait_for_command(devices.required_control("the magnet").release())
                    held = False
                if not frames or held:
                    continue
                block = pipeline.process(frames)
                view.block(frames, block)
                taken += len(frames)
                lost += sum(bool(spot.flags & _UNSEEN) for spot in block.spots)
                for balance in block.balances:
                    found = balance
                    show(balance)
                if frames[-1].time_ns >= end_ns:
                    break
        finally:
            devices.darken()
            stream.close()
    if found is None and stream.failure is not None:
        raise stream.failure
    return BalanceMeasurement(found, lost / max(taken, 1), shape)


def _released_after_s(config: Configuration, devices: Devices, swing_arcsec: float) -> float:
    """Have the starter push, or the magnet hold, as the runs begin; how long until it must let go."""
    start = config.start
    if start.way == "starter":
        part = min(1.0, swing_arcsec / config.session.initial_amplitude_arcsec)
        pulse_s = max(part * start.starter_pulse_s, _SHORTEST_PULSE_S)
        wait_for_command(devices.required_control("the starter").starter_pulse(pulse_s))
    if start.way != "magnet":
        return 0.0
    wait_for_command(devices.required_control("the magnet").hold())
    return config.phases.rest_window_s
