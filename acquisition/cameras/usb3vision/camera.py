"""USB3 Vision cameras as a `Camera`."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
from acquisition.cameras.usb3vision.features import Features
from acquisition.cameras.usb3vision.gencp import GenCpChannel
from acquisition.cameras.usb3vision.link import UsbLink, find_camera
from acquisition.cameras.usb3vision.node_map import load_genapi
from acquisition.cameras.usb3vision.open_camera import UsbConnection
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
        self._session: UsbConnection | None = None
        self._channel: GenCpChannel | None = None
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
                self._session = UsbConnection.learn(link, self._channel)
                self._session.halt_leftovers()
                self._features = self._session.features
                return self._session.info()
            except BaseException:
                self._session = self._features = None
                link.release()
                raise
            finally:
                self._channel = None if self._session is None else self._session.channel

    def start(self) -> None:
        """Set up the stream, then let the camera run."""
        with self._lock, self._translated():
            features, session = self._opened(), self._session
            assert session is not None
            self._must_be_idle()
            self._end_stream()
            pixel_format = features.pixel_format()
            pixel_format.prepare()
            features.run_on()
            expected = ExpectedFrames(
                pixel_format,
                int(features.get("Width")),
                int(features.get("Height")),
                session.identity.timestamp_increment_ns > 0,
                features.plane,
            )
            session.registers.enable(False)
            session.link.reset_stream()
            plan = session.registers.set_up(_LARGEST_FRAME, _LARGEST_TRANSFER)
            if sum(plan.payload) < expected.image_bytes:
                size = f"{expected.width_px} x {expected.height_px} in {pixel_format.name}"
                raise DeviceError(
                    f"{self._name}: announces frames of {sum(plan.payload)} bytes, but {size} takes "
                    f"{expected.image_bytes}; set its size again"
                )
            session.set_locked(True)
            session.registers.enable(True)
            self._before, self._was_lost = self.status.to_begin_with(lost=self._was_lost), False
            self._stream = None
            ahead = self._settings.frames_ahead(features.stated_rate(), expected.image_bytes)
            transfers = self._transfers(session.link, ahead)
            self._stream = UsbFrameStream(transfers, plan, expected, session.link)
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
            with self._translated():
                return stream.reading.read(timeout_s)
        except TimeoutError:
            raise FrameTimeout(
                f"{self._name}: no frame within {timeout_s:g} s; is its trigger on, or its cable loose?"
            ) from None

    def stop(self) -> None:
        stream = self._stream
        if stream is not None:
            stream.reading.request_stop()
        with self._locked_soon() as locked:
            if locked:
                self._end_stream()

    def _end_stream(self) -> None:
        stream, session = self._stream, self._session
        if stream is None:
            return
        stream.reading.request_stop()
        if session is None or not self._camera_runs:
            stream.reading.stop(_JOIN_S)
            return
        self._camera_runs = False
        # each step may fail if the camera is unplugged or does not answer; the others are tried nevertheless
        steps: tuple[Callable[[], None], ...] = (
            lambda: session.features.execute("AcquisitionStop"),
            lambda: session.registers.enable(False),
        )
        for step in steps:
            try:
                with session.channel.within(_COMMANDS_S / len(steps)):
                    step()
            except DeviceError as refused:
                logger.info("%s", refused)
                if isinstance(refused, CameraLost):
                    break
        stream.reading.stop(_JOIN_S)
        try:
            with session.channel.within(_COMMANDS_S / 2):
                session.set_locked(False)
        except DeviceError as refused:
            logger.debug("%s", refused)

    def close(self) -> None:
        stream = self._stream
        if stream is not None:
            stream.reading.request_stop()
        with self._locked_soon() as locked:
            if not locked:
                return  # the call that holds the lock has been told to abort and will release the camera
            self._end_stream()
            session, self._session, self._features, self._channel = self._session, None, None, None
            if session is None:
                return
            if stream is None:
                session.link.release()
            else:
                stream.reading.when_ended(session.link.release)  # a handle must not be closed during a read

    # ---- beyond the protocol

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`, continued after a reconnection."""
        stream = self._stream
        return self._before if stream is None else self._before + stream.status

    @property
    def features(self) -> Features:
        """All features of the open camera, for ``rig camera show`` and ``rig camera set``."""
        return self._opened()

    @contextmanager
    def _locked_soon(self) -> Iterator[bool]:
        """Acquire the lock; a call that holds it while waiting for a silent camera is made to fail."""
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
