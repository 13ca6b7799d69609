"""The live picture while no session has the camera, with exposure, gain and region at hand."""

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Callable

from acquisition.camera import Camera, CameraInfo, CameraSettings, Frame
from processing.errors import DeviceError, RigError
from rig.control import LightRefused, SafetyNow, SafetyState, Stage
from rig.devices import AlignmentFrame, Devices, LightWatch, find_exposure, take_look, watch_latest
from rig.instrument import complete, optics_of, prepare_kernels
from rig.settings import Configuration

_LOOK_S = 0.1
_UNSEEN_S = 30.0
"""Longest time for which the laser stays lit while no browser fetches the picture."""
_LEFT = f"nobody has looked at the picture for {_UNSEEN_S:g} s"
_FOCUS_POINTS = 600
_LEAST_REGION_PX = 8
Wish = Callable[[Camera, CameraInfo, CameraSettings], CameraSettings]
"""Request to a stopped camera, whose settings are given; returns those that it has then."""


class Aligner:
    """A thread that has camera and laser, and looks at the newest frame, ten times a second.

    `look` is the last look (None before the first), `focus` its sharpness over time (seconds, 1/px), `note`
    what the last wish has led to, `darkness` why the laser is dark, `problem` why it has ended. `state` is
    the latch of a rig that has no file. If nobody looks for a while the laser is switched off.
    """

    def __init__(self, config: Configuration, state: SafetyState | None = None) -> None:
        self._state = state
        self._config = complete(config)
        self._wishes: queue.Queue[Wish] = queue.Queue()
        self._ended = threading.Event()
        self.look: AlignmentFrame | None = None
        self.number = 0
        self._looked_s = 0.0
        self.focus: deque[tuple[float, float]] = deque(maxlen=_FOCUS_POINTS)
        self.applied = CameraSettings()
        self.note = ""
        self.problem = ""
        self.darkness = ""
        self._devices: Devices | None = None
        self._relighting = self._off = self._left = False
        self._seen_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="align", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def wish(self, wanted: Callable[[CameraSettings], CameraSettings]) -> None:
        """Ask the camera for settings; `note` tells what came of it.

        They are made from those that hold when their turn comes: a key may be pressed several times before
        the camera has followed once.
        """
        self._wishes.put(lambda camera, _, now: camera.configure(wanted(now)))

    def wish_exposure(self) -> None:
        """Ask for the exposure at which the peak is at its target."""
        self._wishes.put(
            lambda camera, info, now: find_exposure(camera, info, now, on_frame=self._frame_read).applied
        )

    def wish_region(self, left_px: int, top_px: int, width_px: int, height_px: int) -> None:
        """Request a region within the present frame, which may be a region of the sensor already."""
        if (look := self.look) is None:
            return
        rows, columns = look.image.shape
        x0, y0 = self.applied.offset_x_px or 0, self.applied.offset_y_px or 0
        region = CameraSettings(
            width_px=max(_LEAST_REGION_PX, min(width_px, columns)),
            height_px=max(_LEAST_REGION_PX, min(height_px, rows)),
            offset_x_px=x0 + max(0, left_px),
            offset_y_px=y0 + max(0, top_px),
        )
        self.wish(lambda _: region)

    def close(self) -> None:
        """Stop and close the camera; waits until it is free."""
        self._ended.set()
        self._thread.join(10.0)

    @property
    def safety(self) -> SafetyNow | None:
        """The rig's safety state; None before the devices are open, and after they were closed."""
        devices = self._devices
        return None if devices is None else devices.safety()

    def looked_at(self) -> None:
        """Note that a browser has fetched the picture."""
        self._seen_s = time.monotonic()

    def light_off(self) -> None:
        """Switch the laser off at once, also before it was lit; latching the trip may wait for a disk."""
        self._off = True
        if (devices := self._devices) is not None:
            devices.light_off("the desk")

    def acknowledge(self, number: int) -> str:
        """Acknowledge a trip; raises DeviceError while its cause persists. Lights nothing."""
        devices = self._devices
        return "the live picture has ended" if devices is None else devices.acknowledge(number, "the desk")

    def relight(self) -> None:
        """Somebody asks for light again, now: a trip that comes before the picture follows outdates it."""
        if (devices := self._devices) is not None:
            devices.permit.request_light()
            self._relighting = True

    @property
    def late_s(self) -> float:
        """Time in s since the last new frame; 0 before the first frame, and after the end."""
        return time.monotonic() - self._looked_s if self.running and self.number else 0.0

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._watch()
        except Exception as error:
            # any error of a driver ends the picture, and is shown in its place
            self.problem = str(error) or type(error).__name__
        finally:
            self._devices = None

    def _keep_lit_while_seen(self, devices: Devices) -> None:
        if self._relighting:
            self._relighting = self._left = False
            self._seen_s = time.monotonic()
            self.note = _lit(devices)
        if not self._left and devices.permit.begun and time.monotonic() - self._seen_s > _UNSEEN_S:
            self._left = True
            devices.darken(_LEFT)
        self.darkness = _LEFT if self._left else devices.darkness()

    def _frame_read(self, frame: Frame) -> None:
        """Tell the laser's permit of a frame."""
        if (devices := self._devices) is not None:
            devices.permit.frame_read(frame.image)
            # the reader looks at once
            devices.permit.note_progress(Stage.PROCESSING)

    def _say(self, text: str) -> None:
        self.note = text

    def _watch(self) -> None:
        config = self._config
        begun_s = time.monotonic()
        folder = config.session.output
        task = "the live picture"
        with Devices(config, folder, task, self._state) as devices, devices.camera(config) as opened:
            self._devices = devices
            if self._off:
                devices.light_off("the desk")
            info = opened.info
            self.applied = opened.applied or CameraSettings()
            optics = optics_of(config, info.full_scale_dn)
            # compiled while it is dark: a laser may be lit only while frames are looked at
            prepare_kernels(optics.sensor, self._say)
            camera = opened.camera
            self.note = "; ".join((*opened.notes, _lit(devices)))
            self._seen_s = time.monotonic()
            light = LightWatch(devices)
            tracker = optics.tracker()
            reference = optics.reference()
            reference_px = config.lever_reference_px
            while not self._ended.is_set():
                frames = watch_latest(camera, 1, float("inf"), interval_s=_LOOK_S, on_frame=self._frame_read)
                with contextlib.closing(frames):
                    for *_, frame in frames:
                        look = take_look(
                            frame.image, info.full_scale_dn, tracker, reference_px, self.applied, reference
                        )
                        self.focus.append((time.monotonic() - begun_s, look.figures.sharpness_per_px))
                        self.look, self.number = look, self.number + 1
                        self._looked_s = time.monotonic()
                        light.look()
                        self._keep_lit_while_seen(devices)
                        if self._ended.is_set() or not self._wishes.empty():
                            break
                    else:
                        self.problem = "the camera has delivered its last frame"
                        return
                # a camera is configured while it is stopped, and goes on with the next look
                while not self._wishes.empty():
                    wish, before = self._wishes.get(), self.applied
                    try:
                        self.applied = wish(camera, info, before)
                        same = self.applied == before
                        self.note = "nothing has changed: the camera's limit" if same else ""
                    except (DeviceError, RigError) as error:
                        self.note = str(error)
                    tracker, reference = optics.tracker(), optics.reference()
            devices.darken("the live picture is closed")


def _lit(devices: Devices) -> str:
    """Light; what was done, or why the picture lives in the dark until somebody acknowledges and asks."""
    try:
        return devices.light()
    except LightRefused as refused:
        return str(refused)
