"""A run's watcher that hands everything on to the viewer's process."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from acquisition.frame import Frame
from processing.angle import ARCSEC_RAD
from processing.spot import SpotFlag
from rig.config import Configuration
from rig.pipeline import Block
from rig.recorder import Event
from rig.snapshot import Snapshot
from rig.view.balance_quantities import balance_quantities
from rig.view.messages import EventLevel
from rig.view.viewer import ViewCounts, Viewer

_STATE_INTERVAL_S = 0.5
_WARNINGS = {"gap", "spot lost", "camera lost"}


class LiveView:
    """Draws a run while it goes; never waits, drops when the viewer is behind.

    Images are sent at most every `image_interval_s` of the host's time, whatever the frame rate.
    """

    def __init__(self, viewer: Viewer, unit_rad: float, image_interval_s: float, full_scale_dn: int) -> None:
        self._viewer = viewer
        self._unit_rad = unit_rad
        self._image_interval_s = image_interval_s
        self._full_scale_dn = full_scale_dn
        self._next_image_s = 0.0
        self._next_state_s = 0.0

    def block(self, start_ns: int, frames: Sequence[Frame], block: Block) -> None:
        """Deflections, swings, balance and now and then an image."""
        if len(block.times_ns):
            flags = np.array([spot.flags for spot in block.spots], dtype=np.int64)
            times_s = (block.times_ns - start_ns) * 1e-9
            self._viewer.samples(times_s, block.x_rad / self._unit_rad, block.y_rad / self._unit_rad, flags)
        if block.swings:
            self._viewer.swings(
                [(swing.turn_time_ns - start_ns) * 1e-9 for swing in block.swings],
                [swing.amplitude / self._unit_rad for swing in block.swings],
                [2.0 * swing.half_period_s for swing in block.swings],
                u_amplitude_arcsec=[swing.u_amplitude / self._unit_rad for swing in block.swings],
                u_period_s=[2.0 * swing.u_half_period_s for swing in block.swings],
            )
        for balance in block.balances:
            self._viewer.balance(
                (balance.time_ns - start_ns) * 1e-9, balance_quantities(balance, self._unit_rad)
            )
        now_s = time.monotonic()
        if frames and now_s >= self._next_image_s:
            self._next_image_s = now_s + self._image_interval_s
            spot = block.spots[-1]
            position = (spot.x_px, spot.y_px)
            if spot.flags & SpotFlag.LOST:
                position = (float("nan"), float("nan"))
            self._viewer.image(
                (frames[-1].time_ns - start_ns) * 1e-9,
                frames[-1].image,
                position,
                full_scale_dn=self._full_scale_dn,
            )

    def event(self, start_ns: int, event: Event) -> None:
        """One line of the log."""
        level: EventLevel = "warning" if event.kind in _WARNINGS else "info"
        self._viewer.event((event.time_ns - start_ns) * 1e-9, level, f"{event.kind}: {event.text}")

    def snapshot(self, snapshot: Snapshot) -> None:
        """State and losses, twice a second at most."""
        now_s = time.monotonic()
        if now_s < self._next_state_s:
            return
        self._next_state_s = now_s + _STATE_INTERVAL_S
        self._viewer.state(_markdown(snapshot), time_s=snapshot.elapsed_s)
        self._viewer.losses(
            snapshot.elapsed_s,
            {"dropped_frames": snapshot.dropped_frames, "lost_spots": snapshot.lost_spots},
        )

    def close(self) -> ViewCounts:
        """Complete the .rrd file and end the viewer's process."""
        return self._viewer.close()


def open_view(config: Configuration, record: Path, title: str, full_scale_dn: int) -> LiveView | None:
    """The view that the configuration asks for, started; None where it asks for none."""
    settings = config.view
    if settings.mode == "none" and not settings.file:
        return None
    viewer = Viewer(
        record.with_suffix(".rrd") if settings.file else None,
        settings.mode,
        settings.layout,
        title,
        amplitude_arcsec=config.session.initial_amplitude_arcsec,
    )
    viewer.start()
    unit_rad = ARCSEC_RAD if config.lever is not None else 1.0
    return LiveView(viewer, unit_rad, settings.image_interval_s, full_scale_dn)


def _markdown(snapshot: Snapshot) -> str:
    return (
        f"**{snapshot.phase}**\n\n"
        f"- time {snapshot.elapsed_s:.1f} s\n"
        f"- amplitude {snapshot.amplitude:.2f} arcsec, period {snapshot.period_s:.4f} s\n"
        f"- {snapshot.frames} frames, {snapshot.dropped_frames} dropped, {snapshot.lost_spots} spots lost\n"
        f"- {snapshot.half_cycles} half-cycles\n"
    )
