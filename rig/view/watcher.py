"""A run's watcher that hands everything on to the viewer's process."""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from acquisition.frame import Frame
from acquisition.record.events import Event
from processing.balance import Balance
from processing.deflections import DeflectionUnit
from processing.spot import Spot, SpotFlag
from rig.instrument import Block, Snapshot, advice_text
from rig.presentation import balance_numbers
from rig.rerun import LayoutName, LogLevel, Mode
from rig.settings import Configuration
from rig.view.viewer import ViewCounts, Viewer

_STATE_INTERVAL_S = 0.5


class LiveView:
    """Draws a run while it goes; never waits, drops when the viewer is behind.

    Images of a run are sent at most every `image_interval_s` of the host's time, whatever the frame
    rate. `advise` says what is to be done about a balance, in Markdown.
    """

    def __init__(
        self,
        viewer: Viewer,
        unit: DeflectionUnit,
        image_interval_s: float,
        full_scale_dn: int,
        advise: Callable[[Balance], str] = lambda _: "",
    ) -> None:
        self._viewer = viewer
        self._unit = unit
        self._image_interval_s = image_interval_s
        self._full_scale_dn = full_scale_dn
        self._advise = advise
        self._next_image_s = 0.0
        self._next_state_s = 0.0

    def block(self, start_ns: int, frames: Sequence[Frame], block: Block) -> None:
        """Deflections, swings, balance and now and then an image."""
        deflections = block.deflections
        if len(deflections):
            flags = np.array([spot.flags for spot in block.spots], dtype=np.int64)
            times_s = (deflections.times_ns - start_ns) * 1e-9
            self._viewer.samples(times_s, deflections.shown_x, deflections.shown_y, flags)
        if block.swings:
            self._viewer.swings(
                [(swing.turn_time_ns - start_ns) * 1e-9 for swing in block.swings],
                [swing.amplitude / self._unit.shown_size for swing in block.swings],
                [2.0 * swing.half_period_s for swing in block.swings],
                u_amplitude_arcsec=[swing.u_amplitude / self._unit.shown_size for swing in block.swings],
                u_period_s=[2.0 * swing.u_half_period_s for swing in block.swings],
            )
        for balance in block.balances:
            self._viewer.balance(
                (balance.time_ns - start_ns) * 1e-9,
                balance_numbers(balance),
                advice=self._advise(balance),
            )
        now_s = time.monotonic()
        if frames and now_s >= self._next_image_s:
            self._next_image_s = now_s + self._image_interval_s
            self.picture(start_ns, frames[-1], block.spots[-1])

    def picture(self, start_ns: int, frame: Frame, spot: Spot) -> None:
        """A whole frame and the spot in it."""
        position = (spot.x_px, spot.y_px)
        if spot.flags & SpotFlag.LOST:
            position = (math.nan, math.nan)
        time_s = (frame.time_ns - start_ns) * 1e-9
        self._viewer.image(time_s, frame.image, position, full_scale_dn=self._full_scale_dn)

    def jump(self, time_s: float) -> None:
        """What follows begins at another time: no line is drawn to it."""
        self._viewer.samples([time_s], [math.nan], [math.nan], [0])
        self._viewer.event(time_s, "info", f"begun anew at {time_s:.1f} s")

    def event(self, start_ns: int, event: Event) -> None:
        """One line of the log."""
        level: LogLevel = "warning" if event.is_warning else "info"
        self._viewer.event((event.time_ns - start_ns) * 1e-9, level, event.line)

    def snapshot(self, snapshot: Snapshot) -> None:
        """State and losses, twice a second at most."""
        now_s = time.monotonic()
        if now_s < self._next_state_s:
            return
        self._next_state_s = now_s + _STATE_INTERVAL_S
        self._viewer.state(_markdown(snapshot, self._unit.shown), time_s=snapshot.elapsed_s)
        self._viewer.losses(
            snapshot.elapsed_s,
            {"dropped_frames": snapshot.dropped_frames, "lost_spots": snapshot.lost_spots},
        )

    def wait_room(self) -> None:
        """Wait for a viewer that is behind; for a replay that need not keep a pace."""
        self._viewer.wait_room()

    def close(self) -> ViewCounts:
        """Complete the .rrd file and end the viewer's process."""
        return self._viewer.close()


def open_view(config: Configuration, record: Path, title: str, full_scale_dn: int) -> LiveView | None:
    """The view that the configuration asks for, started; None where it asks for none."""
    settings = config.view
    if settings.mode == "none" and not settings.file:
        return None
    rrd = record.with_suffix(".rrd") if settings.file else None
    return start_view(config, rrd, settings.mode, settings.layout, title, full_scale_dn)


def start_view(
    config: Configuration,
    rrd: Path | None,
    mode: Mode,
    layout: LayoutName,
    title: str,
    full_scale_dn: int,
    advise: Callable[[Balance], str] | None = None,
) -> LiveView:
    """A view of a run that goes on, or is replayed: a Rerun file, a live stream, or both.

    `advise` says what to turn where more is known than what the weights should do.
    """
    unit = config.deflection_unit
    viewer = Viewer(
        rrd, mode, layout, title, amplitude_arcsec=config.session.initial_amplitude_arcsec, unit=unit.shown
    )
    viewer.start()
    return LiveView(
        viewer,
        unit,
        config.view.image_interval_s,
        full_scale_dn,
        advise or (lambda balance: advice_text(config, balance)),
    )


def _markdown(snapshot: Snapshot, unit: str) -> str:
    return (
        f"**{snapshot.phase}**\n\n"
        f"- time {snapshot.elapsed_s:.1f} s\n"
        f"- amplitude {snapshot.amplitude:.2f} {unit}, period {snapshot.period_s:.4f} s\n"
        f"- {snapshot.frames} frames, {snapshot.dropped_frames} dropped, {snapshot.lost_spots} spots lost\n"
        f"{_camera_lines(snapshot)}"
        f"- {snapshot.half_cycles} half-cycles\n"
    )


def _camera_lines(snapshot: Snapshot) -> str:
    age_ms = snapshot.frame_age_s * 1e3
    age = "" if math.isnan(age_ms) else f"- frames are {age_ms:.0f} ms old\n"
    return age + (f"- lost: {snapshot.losses}\n" if snapshot.losses.total else "")
