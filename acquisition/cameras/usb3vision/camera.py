"""USB3 Vision cameras as a `Camera`."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from typing import Final

import usb.backend

from acquisition.camera import (
    CameraInfo,
    CameraLost,
    CameraStatus,
    Frame,
    FrameTimeout,
)
from acquisition.cameras.drivers import Usb3VisionSettings
from acquisition.cameras.genicam import GenicamCamera
from acquisition.cameras.pixel_formats import BY_NAME
from acquisition.cameras.usb3vision.description import read_description
from acquisition.cameras.usb3vision.features import Features
from acquisition.cameras.usb3vision.gencp import GenCpChannel
from acquisition.cameras.usb3vision.link import UsbLink, find_camera
from acquisition.cameras.usb3vision.node_map import NodeMap, load_genapi
from acquisition.cameras.usb3vision.packets import (
    Identity,
    StreamRegisters,
    read_identity,
    silence_events,
)
from acquisition.cameras.usb3vision.stream import ExpectedFrames, UsbFrameStream
from acquisition.cameras.usb3vision.transfers import BlockingTransfers, LibusbTransfers, Transfers
from processing.errors import DeviceError

logger = logging.getLogger(__name__)

_LARGEST_FRAME: Final = 1 << 30
_LARGEST_TRANSFER: Final = 1 << 20
_REPLY_S: Final = 0.5
# `stop` and `close` must return within a second whatever the camera does; time limits of their steps
_LOCK_S: Final = 0.2
_COMMANDS_S: Final = 0.25
_JOIN_S: Final = 0.25
_COARSE_NS: Final = 15_000
"""Jitter of the frame times above which the times of turning points suffer."""


class Usb3VisionCamera(GenicamCamera[Features]):
    """Any USB3 Vision camera, through pyusb and libusb.

    Parameters
    ----------
    settings
        The camera to use, and options of the driver.
    backend
        pyusb's backend; None: libusb 1.0.

    Notes
    -----
    After a loss of the camera and a new start the counts continue (`CameraStatus.reconnects`); frames are
    numbered from 0 again.
    """

    def __init__(
        self, settings: Usb3VisionSettings | None = None, backend: usb.backend.IBackend | None = None
    ) -> None:
        super().__init__("USB3 Vision camera")
        self._settings = settings or Usb3VisionSettings()
        self._backend = backend
        self._link: UsbLink | None = None
        self._channel: GenCpChannel | None = None
        self._registers: StreamRegisters | None = None
        self._has_clock = False
        self._stream: UsbFrameStream | None = None
        self._camera_runs = False

    def _is_running(self) -> bool:
        return self._stream is not None and not self._stream.reading.stopped

    # ---- life cycle

    def open(self) -> CameraInfo:
        """Find and claim the camera, and read the description of its features.

        Raises
        ------
        DeviceError
            genicam is not installed; no camera; several and no serial number given; wrong serial number; no
            permission (the message names the udev rule); in use; or an invalid description.
        """
        self.close()
        load_genapi()
        with self._lock:
            found = find_camera(self._settings.serial, self._backend)
            self._name = found.name
            link = UsbLink(found.device, found.name)
            link.claim()
            try:
                self._channel = GenCpChannel(link.send, link.receive, link.name, timeout_s=_REPLY_S)
                identity = read_identity(self._channel)
                silence_events(self._channel, identity.event_address)
                features = self._read_features(self._channel, identity)
                self._registers = StreamRegisters(self._channel, identity.stream_address, link.name)
                self._has_clock = identity.timestamp_increment_ns > 0
                # an acquisition that a program left running when it was killed
                self._try_each(
                    lambda: features.execute("AcquisitionStop"),
                    lambda: self._enable(False),
                    lambda: _set_locked(features, False),
                )
                info = self._info(features, identity)
            except BaseException:
                self._channel = None
                link.release()
                raise
            self._link, self._features = link, features
            return info

    def _read_features(self, channel: GenCpChannel, identity: Identity) -> Features:
        """The camera's features; DeviceError if its description is invalid or incomplete."""
        xml = read_description(channel, identity.manifest_address, self._name)
        features = Features(NodeMap(xml, channel, self._name))
        for name in ("Width", "Height", "PixelFormat", "AcquisitionStart", "AcquisitionStop"):
            if name not in features.nodes:
                raise DeviceError(f"{self._name}: its description lacks {name}, which every camera must have")
        if identity.timestamp_increment_ns > _COARSE_NS:
            logger.warning(
                "%s: its clock counts in steps of %g us, by which the times of its frames are uncertain; "
                "turning times need %g us",
                self._name,
                identity.timestamp_increment_ns / 1e3,
                _COARSE_NS / 1e3,
            )
        return features

    def _info(self, features: Features, identity: Identity) -> CameraInfo:
        """Identity and sensor size of the camera."""
        pixel_format = BY_NAME.get(str(features.get("PixelFormat")))
        return CameraInfo(
            driver="usb3vision",
            vendor=identity.vendor,
            model=identity.model,
            serial=identity.serial,
            width_px=features.sensor_size("Width"),
            height_px=features.sensor_size("Height"),
            full_scale_dn=255 if pixel_format is None else pixel_format.full_scale_dn,
            has_clock=self._has_clock,
            shutter=str(features.get_if_readable("SensorShutterMode") or ""),
        )

    def start(self) -> None:
        """Set up the stream, then let the camera run."""
        with self._lock, self._translate_errors():
            features, link, registers = self._open_features(), self._link, self._registers
            assert link is not None
            assert registers is not None
            self._must_be_idle()
            self._end_stream()
            pixel_format = features.pixel_format()
            pixel_format.prepare()
            features.run_on()
            expected = ExpectedFrames(
                pixel_format,
                int(features.get("Width")),
                int(features.get("Height")),
                self._has_clock,
                features.plane,
            )
            registers.enable(False)
            link.reset_stream()
            plan = registers.set_up(_LARGEST_FRAME, _LARGEST_TRANSFER)
            if sum(plan.payload) < expected.image_bytes:
                size = f"{expected.width_px} x {expected.height_px} in {pixel_format.name}"
                raise DeviceError(
                    f"{self._name}: announces frames of {sum(plan.payload)} bytes, but {size} takes "
                    f"{expected.image_bytes}; set its size again"
                )
            _set_locked(features, True)
            registers.enable(True)
            self._past_counts, self._was_lost = self.status.to_begin_with(lost=self._was_lost), False
            self._stream = None
            ahead = self._settings.frames_ahead(features.stated_rate(), expected.image_bytes)
            transfers = self._transfers(link, ahead)
            self._stream = UsbFrameStream(transfers, plan, expected, link)
            self._camera_runs = True
            try:
                features.execute("AcquisitionStart")
            except DeviceError:
                self.stop()
                raise

    def _transfers(self, link: UsbLink, frames_ahead: int) -> Transfers:
        if self._settings.reading == "auto" and LibusbTransfers.suits(link):
            return LibusbTransfers(link, frames_ahead)
        return BlockingTransfers(link)

    def read(self, timeout_s: float) -> Frame | None:
        stream = self._stream
        if stream is None:
            raise DeviceError(f"{self._name}: is not started; call start before read")
        try:
            with self._translate_errors():
                return stream.reading.read(timeout_s)
        except TimeoutError:
            raise FrameTimeout(
                f"{self._name}: no frame within {timeout_s:g} s; is its trigger on, or its cable loose?"
            ) from None

    def stop(self) -> None:
        stream = self._stream
        if stream is not None:
            stream.reading.request_stop()
        with self._lock_briefly() as locked:
            if locked:
                self._end_stream()

    def _end_stream(self) -> None:
        stream, features, channel = self._stream, self._features, self._channel
        if stream is None:
            return
        stream.reading.request_stop()
        if features is None or channel is None or not self._camera_runs:
            stream.reading.stop(_JOIN_S)
            return
        self._camera_runs = False
        with suppress(CameraLost):
            self._try_each(
                lambda: features.execute("AcquisitionStop"),
                lambda: self._enable(False),
                within_s=_COMMANDS_S / 2,
            )
        stream.reading.stop(_JOIN_S)
        with suppress(CameraLost):
            self._try_each(lambda: _set_locked(features, False), within_s=_COMMANDS_S / 2)

    def _enable(self, on: bool) -> None:
        if self._registers is not None:
            self._registers.enable(on)

    def _try_each(self, *steps: Callable[[], None], within_s: float | None = None) -> None:
        """Call each step, also after others failed because the camera does not answer.

        Raises CameraLost where it is unplugged.
        """
        assert self._channel is not None
        for step in steps:
            try:
                with nullcontext() if within_s is None else self._channel.within(within_s):
                    step()
            except CameraLost:
                raise
            except DeviceError as refused:
                logger.info("%s", refused)

    def close(self) -> None:
        stream = self._stream
        if stream is not None:
            stream.reading.request_stop()
        with self._lock_briefly() as locked:
            if not locked:
                return  # the call that holds the lock has been told to abort and will release the camera
            self._end_stream()
            link, self._link, self._features, self._channel = self._link, None, None, None
            if link is None:
                return
            if stream is None:
                link.release()
            else:
                stream.reading.when_ended(link.release)  # a handle must not be closed during a read

    # ---- beyond the protocol

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`, continued after a reconnection."""
        stream = self._stream
        return self._past_counts if stream is None else self._past_counts + stream.status

    @property
    def features(self) -> Features:
        """All features of the open camera, for ``rig camera show`` and ``rig camera set``."""
        return self._open_features()

    @contextmanager
    def _lock_briefly(self) -> Iterator[bool]:
        """Yield whether the lock was acquired; a call that holds it for a silent camera is aborted."""
        locked = self._lock.acquire(timeout=_LOCK_S)
        channel = self._channel
        if not locked and channel is not None:
            channel.abort()
            locked = self._lock.acquire(timeout=_LOCK_S)
        try:
            yield locked
        finally:
            if locked:
                self._lock.release()


def _set_locked(features: Features, locked: bool) -> None:
    """Lock or unlock the features that determine the size of frames."""
    if features.writable("TLParamsLocked"):
        features.write("TLParamsLocked", int(locked))
