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
from rig.instrument import Optics, Pipeline, optics_of, prepare_kernels
from rig.settings import Configuration
from rig.terminal import answer, say

_EXPOSURE_STEP = 1.25
_GAIN_STEP_DB = 1.0
_END_KEY = "q"
_FRAME_INTERVAL_S = 0.1
_MAX_FRAMES = 1_000_000
_NAME_WIDTH = 20
_LINE_INTERVAL_S = 1.0
"""Interval of lines in a pipe. A pipe without a reader, as after a kill of the desk, ends the picture."""
_MAX_REQUEST_S = 15.0
"""Longest wait of an order for the camera."""
_MAX_UNSEEN_S, _MAX_SILENCE_S = 30.0, 5.0
"""Longest times for which the laser stays lit while no browser fetches the picture, and while the desk that
showed it is silent.
"""


class CameraRequests:
    """Requests of other threads to the thread that has the camera, which stops the camera meanwhile."""

    def __init__(self) -> None:
        self._queue = SimpleQueue[tuple[Callable[[], str], Future[str]]]()

    def put(self, request: Callable[[], str]) -> Future[str]:
        """Queue a request; the future receives what was done, or why not."""
        future: Future[str] = Future()
        self._queue.put((request, future))
        return future

    def ask(self, request: Callable[[], str]) -> str:
        """Queue a request and wait until it is done; a request that waits too long is not carried out."""
        future = self.put(request)
        try:
            return future.result(_MAX_REQUEST_S)
        except TimeoutError:
            future.cancel()
            raise DeviceError(f"the camera has not answered within {_MAX_REQUEST_S:g} s") from None

    @property
    def pending(self) -> bool:
        return not self._queue.empty()

    def carry_out(self) -> str:
        """Carry out all requests; returns the result of the last one."""
        result = ""
        while self.pending:
            request, future = self._queue.get()
            if future.set_running_or_notify_cancel():
                try:
                    result = request()
                except RigError as error:
                    result = str(error)
                future.set_result(result)
        return result


class LivePicture:
    """The camera and the laser of a live picture, which takes `orders` of a desk and has `news` for it.

    Requests to the camera are carried out between two frames.
    """

    def __init__(self, config: Configuration, devices: Devices) -> None:
        self._config, self._devices = config, devices
        self.news = SessionNews()
        self.requests = CameraRequests()
        self.note = ""
        """Result of the last request; part of the news."""
        self.dark = ""
        """The reason why the laser is dark; part of the news, and empty while it is lit."""
        self._is_abandoned = self._has_ended = False
        self._lit_s = self._printed_s = 0.0

    @property
    def orders(self) -> Orders:
        """The orders by name: a `key` as at the terminal, to `set` settings (JSON), and for `light`."""

        def light(_: str) -> str:
            if (trip := self._devices.permit.latched) is not None:
                raise LightRefused(f"{trip.text}: acknowledge it first")
            # now, so that a trip before the picture follows is later than this request
            self._devices.permit.request_light()
            return self.requests.ask(self._light)

        def configure(settings: str) -> str:
            requested = CameraSettings.model_validate_json(settings)
            return self.requests.ask(lambda: self._configure(requested))

        ask = self.requests.ask
        return {"key": lambda key: ask(lambda: self._press(key)), "set": configure, "light": light}

    def show(self, opened: OpenCamera, *, seconds: float = 0.0) -> None:
        """Light the laser and show the newest frames until an order, or the time in s, ends it.

        The camera must be configured and stopped; it is stopped again afterwards and keeps what was set.
        """
        devices, info = self._devices, opened.info
        self._opened, self._applied = opened, opened.applied
        optics = optics_of(self._config, info.full_scale_dn)
        # compiled in the dark: a laser may be lit only while frames are processed
        prepare_kernels(optics.sensor, say)
        end_s = time.monotonic() + seconds if seconds else float("inf")
        watch = LightWatch(devices)
        self.note = "; ".join(filter(None, (*opened.notes, self._light())))
        try:
            with Live(auto_refresh=False) as terminal:
                while not self._has_ended and self._run_until_request(optics, watch, terminal, end_s):
                    # a camera is configured while it is stopped, and goes on with the next round
                    self.note = self.requests.carry_out()
        finally:
            devices.darken("the live picture is closed")

    def _run_until_request(self, optics: Optics, watch: LightWatch, terminal: Live, end_s: float) -> bool:
        """Process the newest frames until a request comes; False once the time is over."""
        devices, full_scale_dn = self._devices, self._opened.info.full_scale_dn
        self.news.begin_run("live picture", full_scale_dn, self._applied)
        self._publish_state()
        pipeline: Pipeline | None = None
        limits = self._config.preflight
        with closing(devices.stream(self._config, self._opened._replace(applied=self._applied))) as stream:
            stream.start_camera()
            stream.begin()
            while not self.requests.pending:
                if not (frames := stream.take(_MAX_FRAMES, _FRAME_INTERVAL_S)):
                    if stream.drained:
                        raise stream.failure or DeviceError("the camera has delivered its last frame")
                    continue
                pipeline = pipeline or Pipeline(optics, frames[-1].image.shape)
                lever = self._config.lever
                look = take_look(frames[-1], full_scale_dn, pipeline, lever, self._applied, limits)
                reference = None if look.reference is None else look.reference.spot
                self.news.show(look.image, look.spot, reference, look.beam)
                self.note = "; ".join(text for _, text in stream.take_events()) or self.note
                watch.look()
                self._keep_lit_while_watched()
                self._print(look, terminal)
                if time.monotonic() >= end_s:
                    return False
                time.sleep(_FRAME_INTERVAL_S)
        return True

    def _print(self, look: AlignmentFrame, terminal: Live) -> None:
        """Show the figures of a frame and a note at the terminal, where they stay; else as a line."""
        figures, note = dict(look.rows()), self.dark or self.note
        answer(picture=figures)
        rows = [(name, text) for name, text in (*figures.items(), ("note", note)) if text]
        console = terminal.console
        if console.is_terminal:
            lines = [f"{name:<{_NAME_WIDTH}}{text}" for name, text in rows]
            terminal.update(Text("\n".join(lines)), refresh=True)
        elif time.monotonic() - self._printed_s >= _LINE_INTERVAL_S:
            self._printed_s = time.monotonic()
            line = "  ".join(f"{name} {text}" for name, text in rows)
            console.print(line, soft_wrap=True, highlight=False)

    def press(self, key: str) -> Future[str]:
        """Queue the request that a key stands for; the future receives its result."""
        return self.requests.put(partial(self._press, key))

    def _light(self) -> str:
        """Light; returns what was done, or why the picture stays dark until a person asks for light."""
        self._is_abandoned, self._lit_s = False, time.monotonic()
        try:
            return self._devices.light()
        except LightRefused as refused:
            return str(refused)

    def _process_frame(self, frame: Frame) -> None:
        """Report a frame of the search for an exposure to the laser's permit, as read and processed."""
        self._devices.permit.frame_read(frame.image)
        self._devices.permit.note_progress(Stage.PROCESSING)

    def _keep_lit_while_watched(self) -> None:
        """Switch the laser off once no browser shows the picture, or the desk has gone."""
        devices, news, lit_s, now_s = self._devices, self.news, self._lit_s, time.monotonic()
        if devices.permit.expects_light and news.news_request_s > 0.0 and not at_terminal():
            is_unseen = now_s - max(news.picture_request_s, lit_s) > _MAX_UNSEEN_S
            if is_unseen or now_s - max(news.news_request_s, lit_s) > _MAX_SILENCE_S:
                self._is_abandoned = True
                devices.darken(_ABANDONED)
        self.dark = _ABANDONED if self._is_abandoned else devices.darkness()
        if self.dark and devices.permit.needs_request and devices.permit.latched is None:
            self.dark = NEEDS_REQUEST
        self._publish_state()

    def _publish_state(self) -> None:
        self.news.state({"dark": self.dark, "note": self.note}, ())

    def _press(self, key: str) -> str:
        """Carry out a key that sets the camera, or ends the picture; returns the result."""
        applied = self._applied
        self._has_ended = self._has_ended or key == _END_KEY
        if key == "a":
            camera = self._opened.camera
            try:
                find_exposure(camera, self._opened.info, applied, on_frame=self._process_frame)
            finally:
                # a search that fails leaves the camera with its last exposure
                self._applied = camera.configure(CameraSettings())
            return "" if self._applied != applied else "nothing has changed: the exposure is right"
        if key in ("e", "E"):
            if applied.exposure_us is None:
                raise DeviceError(f"the exposure: {_NOT_REPORTED}")
            factor = _EXPOSURE_STEP if key == "E" else 1 / _EXPOSURE_STEP
            return self._configure(CameraSettings(exposure_us=applied.exposure_us * factor))
        if key in ("g", "G"):
            if applied.gain_db is None:
                raise DeviceError(f"the gain: {_NOT_REPORTED}")
            step_db = _GAIN_STEP_DB if key == "G" else -_GAIN_STEP_DB
            return self._configure(CameraSettings(gain_db=applied.gain_db + step_db))
        return self.note

    def _configure(self, requested: CameraSettings) -> str:
        """Set the camera; returns a note on what it has not set."""
        earlier, self._applied = self._applied, self._opened.camera.configure(requested)
        return "" if self._applied != earlier else "nothing has changed: the camera's limit"


_ABANDONED = f"nobody has looked at the picture for {_MAX_UNSEEN_S:g} s, or the desk does not answer"
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
