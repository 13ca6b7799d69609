"""Alignment of laser and camera by eye: the newest frame for a desk, its figures at a terminal."""

import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing
from functools import partial
from queue import SimpleQueue

from rich.live import Live
from rich.text import Text

from acquisition.camera import CameraSettings, Frame
from processing.errors import DeviceError, RigError
from rig.control import NEEDS_REQUEST, LightRefused, Stage
from rig.devices.acknowledgement import LightWatch, ask_acknowledgement, at_terminal
from rig.devices.alignment_look import AlignmentFrame, take_look
from rig.devices.order_socket import Orders, SessionNews, light_shown_to_desk
from rig.devices.picture import find_exposure
from rig.devices.session_devices import Devices, OpenCamera
from rig.instrument import Optics, optics_of, prepare_kernels
from rig.settings import Configuration
from rig.terminal import answer, say

_EXPOSURE_STEP = 1.25
_GAIN_STEP_DB = 1.0
_END = "q"
_LOOK_S = 0.1
_ALL = 1_000_000
_NAMES = 20
"""Width of the names of figures."""
_LINE_INTERVAL_S = 1.0
"""Interval of lines in a pipe. One that nobody reads, as after a kill of the desk, ends the picture."""
_DONE_WITHIN_S = 15.0
"""Longest wait of an order for the camera."""
_UNSEEN_S, _UNASKED_S = 30.0, 5.0
"""Longest times for which the laser stays lit while no browser fetches the picture, and while the desk that
showed it is silent.
"""


class CameraRequests:
    """What other threads request of the thread that has the camera, which stops it meanwhile."""

    def __init__(self) -> None:
        self._queue = SimpleQueue[tuple[Callable[[], str], Future[str]]]()

    def put(self, request: Callable[[], str]) -> Future[str]:
        """Request something; returns what will have been done, or why not."""
        done: Future[str] = Future()
        self._queue.put((request, done))
        return done

    def ask(self, request: Callable[[], str]) -> str:
        """Request something, and wait until it is done; what comes too late is not done."""
        done = self.put(request)
        try:
            return done.result(_DONE_WITHIN_S)
        except TimeoutError:
            done.cancel()
            raise DeviceError(f"the camera has not answered within {_DONE_WITHIN_S:g} s") from None

    @property
    def waiting(self) -> bool:
        return not self._queue.empty()

    def carry_out(self) -> str:
        """Do all that was requested; returns what the last one has led to."""
        said = ""
        while self.waiting:
            request, done = self._queue.get()
            if done.set_running_or_notify_cancel():
                try:
                    said = request()
                except RigError as error:
                    said = str(error)
                done.set_result(said)
        return said


class LivePicture:
    """The camera and the laser of a live picture, which takes `orders` of a desk and has `news` for it.

    `requests` are carried out between two looks. `note` says what the last one has led to, `dark` why the
    laser is; the news have both.
    """

    def __init__(self, config: Configuration, devices: Devices) -> None:
        self._config, self._devices = config, devices
        self.news = SessionNews()
        self.requests = CameraRequests()
        self.note = self.dark = ""
        self._left = self._over = False
        self._lit_s = self._printed_s = 0.0

    @property
    def orders(self) -> Orders:
        """The orders by name: a `key` as at the terminal, to `set` settings (JSON), and for `light`."""

        def light(_: str) -> str:
            if (trip := self._devices.permit.latched) is not None:
                raise LightRefused(f"{trip.text}: acknowledge it first")
            # it is asked for now: a trip that comes before the picture follows outdates it
            self._devices.permit.request_light()
            return self.requests.ask(self._light)

        def set_(settings: str) -> str:
            wanted = CameraSettings.model_validate_json(settings)
            return self.requests.ask(lambda: self._configured(wanted))

        return {"key": lambda key: self.requests.ask(lambda: self._press(key)), "set": set_, "light": light}

    def show(self, opened: OpenCamera, *, seconds: float = 0.0) -> None:
        """Light the laser and show the newest frames until an order, or the time in s, ends it.

        The camera must be configured and stopped; it is stopped again afterwards and keeps what was set.
        """
        devices, info = self._devices, opened.info
        self._opened, self._applied = opened, opened.applied
        optics = optics_of(self._config, info.full_scale_dn)
        # compiled while it is dark: a laser may be lit only while frames are looked at
        prepare_kernels(optics.sensor, say)
        end_s = time.monotonic() + seconds if seconds else float("inf")
        watch = LightWatch(devices)
        self.note = "; ".join(filter(None, (*opened.notes, self._light())))
        try:
            with Live(auto_refresh=False) as terminal:
                while not self._over and self._look_until_asked(optics, watch, terminal, end_s):
                    # a camera is configured while it is stopped, and goes on with the next round
                    self.note = self.requests.carry_out()
        finally:
            devices.darken("the live picture is closed")

    def _look_until_asked(self, optics: Optics, watch: LightWatch, terminal: Live, end_s: float) -> bool:
        """Look at the newest frames until something is requested; False once the time is over."""
        devices, full_scale_dn = self._devices, self._opened.info.full_scale_dn
        self.news.begin_run("live picture", full_scale_dn, self._applied)
        self._tell()
        trackers = optics.dual_tracker()
        with closing(devices.stream(self._config, self._opened._replace(applied=self._applied))) as stream:
            stream.start_camera()
            stream.begin()
            while not self.requests.waiting:
                if not (frames := stream.take(_ALL, _LOOK_S)):
                    if stream.drained:
                        raise stream.failure or DeviceError("the camera has delivered its last frame")
                    continue
                image, crosshair_px, applied = (
                    frames[-1].image,
                    self._config.lever_reference_px,
                    self._applied,
                )
                look = take_look(image, full_scale_dn, trackers, crosshair_px, applied)
                of_reference = None if look.reference is None else look.reference.spot
                self.news.show(image, look.spot, of_reference, look.beam)
                self.note = "; ".join(text for _, text in stream.take_events()) or self.note
                watch.look()
                self._keep_lit_while_seen()
                self._print(look, terminal)
                if time.monotonic() >= end_s:
                    return False
                time.sleep(_LOOK_S)
        return True

    def _print(self, look: AlignmentFrame, terminal: Live) -> None:
        """Show the figures of a frame and a note at the terminal, where they stay; else as a line."""
        figures, note = dict(look.rows()), self.dark or self.note
        answer(picture=figures)
        shown = [(name, text) for name, text in (*figures.items(), ("note", note)) if text]
        console = terminal.console
        if console.is_terminal:
            terminal.update(Text("\n".join(f"{name:<{_NAMES}}{text}" for name, text in shown)), refresh=True)
        elif time.monotonic() - self._printed_s >= _LINE_INTERVAL_S:
            self._printed_s = time.monotonic()
            console.print(
                "  ".join(f"{name} {text}" for name, text in shown), soft_wrap=True, highlight=False
            )

    def press(self, key: str) -> Future[str]:
        """Request what a key means; returns what will have come of it."""
        return self.requests.put(partial(self._press, key))

    def _light(self) -> str:
        """Light; what was done, or why the picture lives in the dark until somebody acknowledges and asks."""
        self._left, self._lit_s = False, time.monotonic()
        try:
            return self._devices.light()
        except LightRefused as refused:
            return str(refused)

    def _frame_read(self, frame: Frame) -> None:
        """Tell the laser's permit of a frame of the search of an exposure, which looks at it at once."""
        self._devices.permit.frame_read(frame.image)
        self._devices.permit.note_progress(Stage.PROCESSING)

    def _keep_lit_while_seen(self) -> None:
        """Switch the laser off once nobody looks at the desk that shows it, or the desk is gone."""
        devices, news, now_s = self._devices, self.news, time.monotonic()
        if devices.permit.expects_light and news.asked_s > 0.0 and not at_terminal():
            seen_s, asked_s = max(news.looked_s, self._lit_s), max(news.asked_s, self._lit_s)
            if now_s - seen_s > _UNSEEN_S or now_s - asked_s > _UNASKED_S:
                self._left = True
                devices.darken(_LEFT)
        self.dark = _LEFT if self._left else devices.darkness()
        if self.dark and devices.permit.needs_request and devices.permit.latched is None:
            self.dark = NEEDS_REQUEST
        self._tell()

    def _tell(self) -> None:
        self.news.state({"dark": self.dark, "note": self.note}, ())

    def _press(self, key: str) -> str:
        """Carry out a key that sets the camera, or ends the picture; returns what came of it."""
        applied = self._applied
        self._over = self._over or key == _END
        if key == "a":
            camera, info = self._opened.camera, self._opened.info
            found = find_exposure(camera, info, applied, on_frame=self._frame_read)
            self._applied = found.applied
            return "" if found.applied != applied else "nothing has changed: the exposure is right"
        if key in ("e", "E"):
            if applied.exposure_us is None:
                raise DeviceError(f"the exposure: {_NOT_REPORTED}")
            factor = _EXPOSURE_STEP if key == "E" else 1 / _EXPOSURE_STEP
            return self._configured(CameraSettings(exposure_us=applied.exposure_us * factor))
        if key in ("g", "G"):
            if applied.gain_db is None:
                raise DeviceError(f"the gain: {_NOT_REPORTED}")
            step_db = _GAIN_STEP_DB if key == "G" else -_GAIN_STEP_DB
            return self._configured(CameraSettings(gain_db=applied.gain_db + step_db))
        return self.note

    def _configured(self, wanted: CameraSettings) -> str:
        """Set the camera; returns a note on what it has not set."""
        before, self._applied = self._applied, self._opened.camera.configure(wanted)
        return "" if self._applied != before else "nothing has changed: the camera's limit"


_LEFT = f"nobody has looked at the picture for {_UNSEEN_S:g} s, or the desk does not answer"
_NOT_REPORTED = "this camera does not report its setting: state a value"


def align_camera(config: Configuration, *, seconds: float = 0.0) -> None:
    """Open the rig and show the live picture to a desk, its figures at the terminal."""
    output = config.session.output
    with Devices(config, output, "rig camera align") as devices:
        picture = LivePicture(config, devices)
        with (
            light_shown_to_desk(devices, output, picture.news, picture.orders),
            devices.camera(config) as opened,
        ):
            ask_acknowledgement(devices)
            picture.show(opened, seconds=seconds)
