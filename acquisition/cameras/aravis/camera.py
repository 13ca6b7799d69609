"""GigE Vision and USB3 Vision cameras through libaravis, as a `Camera`."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from acquisition.camera import CameraInfo, CameraLost, Frame
from acquisition.cameras.aravis.library import (
    AravisFeatures,
    BufferReader,
    Library,
    find_camera,
    load_library,
)
from acquisition.cameras.drivers import AravisSettings, buffer_count
from acquisition.cameras.genicam import GenicamCamera
from acquisition.cameras.reading import CameraRun
from acquisition.frames.losses import LAST_SHORT_ID
from processing.errors import DeviceError

logger = logging.getLogger(__name__)

_MAX_CLOSE_WAIT_S: Final = 0.4
"""Longest wait of `stop` and `close` for libaravis."""
_MAX_RELEASE_S: Final = 15.0
"""Longest wait of `open` and `start` for earlier actions."""
_MAX_SILENCE_S: Final = 1.0
"""Silence after which a register is read, because libaravis takes 6 s to notice the loss of a GigE camera,
and may not monitor a USB camera at all.
"""
_GIGE_CONTROL_REGISTER: Final = 0x0A00
_USB_VERSION_REGISTER: Final = 0x0000
_TICKS_REGISTERS: Final = (0x093C, 0x0940)


class AravisCamera(GenicamCamera[AravisFeatures]):
    """A GigE Vision or USB3 Vision camera read by libaravis, which acquires and queues the frames.

    The host time of a frame is the arrival of its first bytes, as recorded by libaravis. If no frames
    arrive, a register is read to test the connection; a camera that does not answer is reported as lost.
    """

    _HINT = "; is it in use by another program, or has it lost its cable?"

    def __init__(self, settings: AravisSettings | None = None) -> None:
        super().__init__("aravis camera")
        self._settings = settings or AravisSettings()
        self._library: Library | None = None
        self._stream: Any = None
        self._has_clock = False
        self._closings = 0
        self._gone = threading.Event()
        self._closing = _ClosingActions()
        self._probe: threading.Thread | None = None
        self._last_reply_s = 0.0
        self._buffers: BufferReader | None = None

    def _library_error(self) -> type[Exception]:
        return DeviceError if self._library is None else self._library.error

    def _is_gone(self) -> bool:
        return self._gone.is_set()

    # ---- life cycle

    def open(self) -> CameraInfo:
        """Find the camera and take control of it.

        Raises DeviceError where libaravis or PyGObject is missing, the choice of the camera is not clear, or
        it is in use.
        """
        self.close()
        with self._lock:
            self._closing.wait(self._name)
            closings = self._closings
            self._library = load_library()
            identity, self._name = find_camera(self._settings.serial)
            self._gone = threading.Event()
            with self._translate_errors():
                info, features = self._take_control(self._library, identity)
            if closings != self._closings:
                self._closing.run(None, features.release(), self._library.error)
                raise DeviceError(f"{self._name}: was closed while it was opened")
            self._features = features
            return info

    def _take_control(self, library: Library, identity: str) -> tuple[CameraInfo, AravisFeatures]:
        camera = library.aravis.Camera.new(identity)
        # a local variable, because the signal's handler must keep no reference to this object
        gone = self._gone
        camera.get_device().connect("control-lost", lambda *_: gone.set())
        camera.stop_acquisition()  # a program that crashed may have left it running
        features = AravisFeatures(camera, library.aravis, self._name)
        features.choose_usable_format()
        if camera.is_gv_device():
            self._set_packet_size(library, camera)
            device = camera.get_device()
            self._has_clock = any(device.read_register(address) for address in _TICKS_REGISTERS)
        else:
            self._has_clock = True
        vendor, model = camera.get_vendor_name(), camera.get_model_name()
        serial = camera.get_device_serial_number() or ""
        info = features.info("aravis", vendor, model, serial, has_clock=self._has_clock)
        return info, features

    def _set_packet_size(self, library: Library, camera: Any) -> None:
        packet_bytes = self._settings.packet_bytes
        if packet_bytes is not None:
            camera.gv_set_packet_size(packet_bytes)
            return
        try:
            camera.gv_auto_packet_size()
        except library.error as error:
            logger.info("%s: packet size not changed: %s", self._name, error)

    def start(self) -> None:
        """Start the acquisition of every frame, in order, into new buffers."""
        with self._lock, self._translate_errors():
            features = self._open_device()
            self._must_be_idle()
            self._closing.wait(self._name)
            camera, library = features.camera, self._library
            assert library is not None
            expected = features.expected_frames(has_clock=self._has_clock)
            features.select_continuous()
            stream = camera.create_stream(None, None)
            payload = camera.get_payload()
            count = buffer_count(features.expected_rate_hz(), payload, 64, 4096)
            for _ in range(count):
                stream.push_buffer(library.aravis.Buffer.new_allocate(payload))
            numbers = self._begin((LAST_SHORT_ID,) if camera.is_gv_device() else ())
            self._buffers = BufferReader(library.aravis, self._name, expected, numbers)
            self._last_reply_s = time.monotonic()
            self._stream = stream
            del stream
            self._run = CameraRun(self._next, self._end)
            try:
                camera.start_acquisition()
            except BaseException:
                self.stop()
                raise

    def _next(self, timeout_s: float) -> Frame | None:
        stream, features, buffers, run = self._stream, self._features, self._buffers, self._run
        if stream is None or features is None or buffers is None or run is None:
            return None
        buffer = stream.timeout_pop_buffer(max(round(timeout_s * 1e6), 1))
        if self._gone.is_set():
            raise CameraLost(f"{self._name}: is no longer connected; plug it in again")
        if buffer is None:
            self._test_connection(features)
            return None
        self._last_reply_s = time.monotonic()
        try:
            if run.stopped:
                return None  # buffers that were cancelled are returned empty
            return buffers.frame(buffer, stream.get_info_uint64_by_name("n_underruns"))
        finally:
            stream.push_buffer(buffer)

    def _test_connection(self, features: AravisFeatures) -> None:
        """Test the connection of a silent camera: a thread reads a register, and notes a failure."""
        camera, library, gone = features.camera, self._library, self._gone
        now_s = time.monotonic()
        is_probing = self._probe is not None and self._probe.is_alive()
        if is_probing or camera is None or library is None or now_s - self._last_reply_s < _MAX_SILENCE_S:
            return
        address = _GIGE_CONTROL_REGISTER if camera.is_gv_device() else _USB_VERSION_REGISTER

        def probe() -> None:
            try:
                camera.get_device().read_register(address)
            except library.error:
                gone.set()

        self._last_reply_s = now_s
        self._probe = threading.Thread(target=probe, name=f"asks {self._name}", daemon=True)
        self._probe.start()

    def _end(self) -> None:
        """Stop the camera and drop the stream, which is no longer read."""
        features, gone = self._features, self._gone
        references, self._stream = [self._stream], None
        camera = None if features is None else features.camera
        if self._library is None:
            return
        action = None if camera is None or gone.is_set() else camera.stop_acquisition
        del camera
        self._closing.run(action, references, self._library.error)

    def close(self) -> None:
        self._closings += 1
        self.stop()
        features, self._features = self._features, None
        if features is not None and self._library is not None:
            self._closing.run(None, features.release(), self._library.error)


class _ClosingActions:
    """Runs the final actions on a camera in threads, one after the other, and waits for them only briefly,
    because libaravis waits 2.5 s for each reply of a lost camera.
    """

    def __init__(self) -> None:
        self._threads: list[threading.Thread] = []

    def run(self, action: Callable[[], None] | None, references: list[Any], error: type[Exception]) -> None:
        """Run the action, if any, then clear the list `references`; returns after 0.4 s, finished or not.

        There must be no other references to the objects in the list, because dropping the last reference to a
        camera waits for its reply.
        """
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        thread = threading.Thread(
            target=_run_action,
            args=(action, references, error, list(self._threads)),
            name="leaves camera",
            daemon=True,
        )
        del action
        self._threads.append(thread)
        thread.start()
        thread.join(_MAX_CLOSE_WAIT_S)

    def wait(self, name: str) -> None:
        """Wait until all actions are finished; a camera that is still being released must not be opened.

        Raises DeviceError if that takes too long.
        """
        deadline_s = time.monotonic() + _MAX_RELEASE_S
        for thread in list(self._threads):
            thread.join(max(deadline_s - time.monotonic(), 0.0))
            if thread.is_alive():
                raise DeviceError(f"{name}: does not answer, and is still being closed; wait")


def _run_action(
    action: Callable[[], None] | None,
    references: list[Any],
    error: type[Exception],
    earlier: list[threading.Thread],
) -> None:
    """Run the action after the `earlier` threads have ended, then clear the list `references`."""
    for thread in earlier:
        thread.join()
    try:
        if action is not None:
            action()
    except error as failure:
        logger.info("%s", failure)
    references.clear()
