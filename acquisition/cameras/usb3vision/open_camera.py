"""A camera whose interfaces are claimed and whose features have been read."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Self

from acquisition.camera import CameraInfo, CameraLost
from acquisition.cameras.pixel_formats import BY_NAME
from acquisition.cameras.usb3vision.features import Features
from acquisition.cameras.usb3vision.gencp import GenCpChannel
from acquisition.cameras.usb3vision.link import UsbLink
from acquisition.cameras.usb3vision.manifest import read_description
from acquisition.cameras.usb3vision.node_map import NodeMap
from acquisition.cameras.usb3vision.registers import (
    Identity,
    StreamRegisters,
    read_identity,
    silence_events,
)
from processing.errors import DeviceError

logger = logging.getLogger(__name__)

_COARSE_NS: Final = 15_000
"""Jitter of the frame times above which the times of turning points suffer."""


@dataclass(frozen=True, slots=True)
class UsbConnection:
    """Connection, registers and features of an open camera."""

    link: UsbLink
    channel: GenCpChannel
    identity: Identity
    features: Features
    registers: StreamRegisters

    @classmethod
    def learn(cls, link: UsbLink, channel: GenCpChannel) -> Self:
        """Read the camera's identity and features; DeviceError if they are invalid or incomplete."""
        identity = read_identity(channel)
        silence_events(channel, identity.event_address)
        xml = read_description(channel, identity.manifest_address, link.name)
        features = Features(NodeMap(xml, channel, link.name))
        for name in ("Width", "Height", "PixelFormat", "AcquisitionStart", "AcquisitionStop"):
            if name not in features.nodes:
                raise DeviceError(f"{link.name}: its description lacks {name}, which every camera must have")
        if identity.timestamp_increment_ns > _COARSE_NS:
            logger.warning(
                "%s: its clock counts in steps of %g us, by which the times of its frames are uncertain; "
                "turning times need %g us",
                link.name,
                identity.timestamp_increment_ns / 1e3,
                _COARSE_NS / 1e3,
            )
        registers = StreamRegisters(channel, identity.stream_address, link.name)
        return cls(link, channel, identity, features, registers)

    def halt_leftovers(self) -> None:
        """Stop an acquisition that a program left running when it was killed."""
        steps: tuple[Callable[[], None], ...] = (
            lambda: self.features.execute("AcquisitionStop"),
            lambda: self.registers.enable(False),
            lambda: self.set_locked(False),
        )
        for step in steps:
            try:
                step()
            except CameraLost:
                raise
            except DeviceError as refused:
                logger.debug("%s", refused)

    def info(self) -> CameraInfo:
        """Identity and sensor size of the camera."""
        features, identity = self.features, self.identity
        pixel_format = BY_NAME.get(str(features.get("PixelFormat")))
        return CameraInfo(
            driver="usb3vision",
            vendor=identity.vendor,
            model=identity.model,
            serial=identity.serial,
            width_px=features.sensor_size("Width"),
            height_px=features.sensor_size("Height"),
            full_scale_dn=255 if pixel_format is None else pixel_format.full_scale_dn,
            has_clock=identity.timestamp_increment_ns > 0,
            shutter=str(features.get_if_readable("SensorShutterMode") or ""),
        )

    def set_locked(self, locked: bool) -> None:
        """Lock or unlock the features that determine the size of frames."""
        if self.features.writable("TLParamsLocked"):
            self.features.write("TLParamsLocked", int(locked))
