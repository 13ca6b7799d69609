"""USB3 Vision cameras as a `Camera`."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from typing import Final

import usb.backend

from acquisition.camera import CameraInfo, CameraLost
from acquisition.cameras.drivers import Usb3VisionSettings, frames_ahead
from acquisition.cameras.genicam import GenicamCamera
from acquisition.cameras.reading import CameraRun
from acquisition.cameras.usb3vision.gencp import GenCpChannel
from acquisition.cameras.usb3vision.link import UsbLink, find_camera
from acquisition.cameras.usb3vision.node_map import NodeMap, load_genapi, read_description
from acquisition.cameras.usb3vision.packets import (
    Identity,
    StreamRegisters,
    read_identity,
    silence_events,
)
from acquisition.cameras.usb3vision.stream import COUNTERS, UsbFrameStream
from acquisition.cameras.usb3vision.transfers import BlockingTransfers, LibusbTransfers, Transfers
from processing.errors import DeviceError

logger = logging.getLogger(__name__)

_MAX_FRAME_BYTES: Final = 1 << 30
_MAX_TRANSFER_BYTES: Final = 1 << 20
_REPLY_TIMEOUT_S: Final = 0.5
# the three limits together let `stop` and `close` return within a second, whatever the camera does
_LOCK_TIMEOUT_S: Final = 0.2
_COMMANDS_TIMEOUT_S: Final = 0.25
_READ_END_TIMEOUT_S: Final = 0.25
_MAX_CLOCK_STEP_NS: Final = 15_000
"""Resolution of the camera's clock above which the times of turning points become less accurate."""


class Usb3VisionCamera(GenicamCamera[NodeMap]):
    """Any USB3 Vision camera, through pyusb's `backend` (None: libusb 1.0).

    After a loss of the camera and a new start the counts continue (`CameraStatus.reconnects`); frames are
    numbered from 0 again.
    """

    _SILENT = "is its trigger on, or its cable loose?"

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
        self._camera_is_running = False

    # ---- life cycle

    def open(self) -> CameraInfo:
        """Find and claim the camera, and read the description of its features.

        Raises DeviceError where genicam is not installed, the choice of the camera is not clear, permission
        is missing (the message names the udev rule), it is in use, or its description is invalid.
        """
        self.close()
        load_genapi()
        with self._lock:
            camera = find_camera(self._settings.serial, self._backend)
            self._name = camera.name
            link = UsbLink(camera.device, camera.name)
            link.claim()
            try:
                self._channel = GenCpChannel(link.send, link.receive, link.name, timeout_s=_REPLY_TIMEOUT_S)
                identity = read_identity(self._channel)
                silence_events(self._channel, identity.event_address)
                features = self._read_features(self._channel, identity)
                registers = StreamRegisters(self._channel, identity.stream_address, link.name)
                self._has_clock = identity.timestamp_increment_ns > 0
                # end an acquisition that a killed program left running
                self._try_each(
                    lambda: features.write("AcquisitionStop", True),
                    lambda: registers.enable(False),
                    lambda: _set_locked(features, False),
                )
                info = features.info(
                    "usb3vision", identity.vendor, identity.model, identity.serial, has_clock=self._has_clock
                )
            except BaseException:
                self._channel = None
                link.release()
                raise
            self._link, self._features, self._registers = link, features, registers
            return info

    def _read_features(self, channel: GenCpChannel, identity: Identity) -> NodeMap:
        """The camera's features; DeviceError if its description is invalid or incomplete."""
        xml = read_description(channel, identity.manifest_address, self._name)
        features = NodeMap(xml, channel, self._name)
        for name in ("Width", "Height", "PixelFormat", "AcquisitionStart", "AcquisitionStop"):
            if not features.has(name):
                raise DeviceError(f"{self._name}: its description lacks {name}, which every camera must have")
        if identity.timestamp_increment_ns > _MAX_CLOCK_STEP_NS:
            logger.warning(
                "%s: its clock counts in steps of %g us, by which the times of its frames are uncertain; "
                "turning times need %g us",
                self._name,
                identity.timestamp_increment_ns / 1e3,
                _MAX_CLOCK_STEP_NS / 1e3,
            )
        return features

    def start(self) -> None:
        """Set up the stream, then start the camera's acquisition."""
        with self._lock, self._translate_errors():
            features, link, registers = self._open_device(), self._link, self._registers
            assert link is not None
            assert registers is not None
            self._must_be_idle()
            self._end_run()
            expected = features.expected_frames(has_clock=self._has_clock)
            features.select_continuous()
            registers.enable(False)
            link.reset_stream()
            plan = registers.set_up(_MAX_FRAME_BYTES, _MAX_TRANSFER_BYTES)
            image_bytes = expected.image_bytes()
            if sum(plan.payload) < image_bytes:
                size = f"{expected.width_px} x {expected.height_px} in {expected.format.name}"
                raise DeviceError(
                    f"{self._name}: announces frames of {sum(plan.payload)} bytes, but {size} takes "
                    f"{image_bytes}; set its size again"
                )
            _set_locked(features, True)
            registers.enable(True)
            numbers = self._begin(COUNTERS, has_clock=expected.has_clock)
            ahead = frames_ahead(features.expected_rate_hz(), image_bytes)
            transfers = self._transfers(link, ahead)
            self._stream = UsbFrameStream(transfers, plan, expected, link, numbers)
            self._run = CameraRun(self._stream.step, transfers.cancel)
            self._camera_is_running = True
            try:
                features.write("AcquisitionStart", True)
            except DeviceError:
                self.stop()
                raise

    def _transfers(self, link: UsbLink, frames_ahead: int) -> Transfers:
        if self._settings.reading == "auto" and LibusbTransfers.suits(link):
            return LibusbTransfers(link, frames_ahead)
        return BlockingTransfers(link)

    def stop(self) -> None:
        if self._run is not None:
            self._run.request_stop()
        with self._lock_briefly() as locked:
            if locked:
                self._end_run()

    def _end_run(self) -> None:
        run, features, registers = self._run, self._features, self._registers
        if run is None:
            return
        run.request_stop()
        if features is None or registers is None or not self._camera_is_running:
            run.stop(_READ_END_TIMEOUT_S)
            return
        self._camera_is_running = False
        with suppress(CameraLost):
            self._try_each(
                lambda: features.write("AcquisitionStop", True),
                lambda: registers.enable(False),
                limit_s=_COMMANDS_TIMEOUT_S / 2,
            )
        run.stop(_READ_END_TIMEOUT_S)
        with suppress(CameraLost):
            self._try_each(lambda: _set_locked(features, False), limit_s=_COMMANDS_TIMEOUT_S / 2)

    def _try_each(self, *steps: Callable[[], None], limit_s: float | None = None) -> None:
        """Call each step, also after one that was not answered; CameraLost where the camera is unplugged."""
        assert self._channel is not None
        for step in steps:
            try:
                with nullcontext() if limit_s is None else self._channel.time_limit(limit_s):
                    step()
            except CameraLost:
                raise
            except DeviceError as failure:
                logger.info("%s", failure)

    def close(self) -> None:
        if self._run is not None:
            self._run.request_stop()
        with self._lock_briefly() as locked:
            if not locked:
                return  # the aborted call, which still holds the lock, will release the camera
            self._end_run()
            link, self._link, self._features = self._link, None, None
            self._channel = self._registers = None
            if link is not None:
                self._when_idle(link.release)

    # ---- not part of the protocol `Camera`

    @property
    def features(self) -> NodeMap:
        """All features of the open camera, for ``rig camera show``."""
        return self._open_device()

    @contextmanager
    def _lock_briefly(self) -> Iterator[bool]:
        """Yield whether the lock was acquired; a call that holds it for a silent camera is aborted."""
        locked = self._lock.acquire(timeout=_LOCK_TIMEOUT_S)
        channel = self._channel
        if not locked and channel is not None:
            channel.abort()
            locked = self._lock.acquire(timeout=_LOCK_TIMEOUT_S)
        try:
            yield locked
        finally:
            if locked:
                self._lock.release()


def _set_locked(features: NodeMap, locked: bool) -> None:
    """Lock or unlock the features that determine the size of frames."""
    if features.writable("TLParamsLocked"):
        features.write("TLParamsLocked", int(locked))
