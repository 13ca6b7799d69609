"""Alignment of laser and camera by eye: shows the newest frames, at a terminal and to a desk, until ended."""

import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.style import Style
from rich.text import Text

from acquisition import atomic_write
from acquisition.camera import CameraSettings, Frame
from processing.errors import DeviceError, RigError
from rig.control import NEEDS_REQUEST, LightRefused, Stage
from rig.devices.acknowledgement import LightWatch, ask_leave, at_terminal
from rig.devices.alignment_look import AlignmentFrame, annotated_picture, take_look
from rig.devices.order_socket import Orders, SessionNews, light_shown_to_desk
from rig.devices.picture import find_exposure, png_of, watch_latest
from rig.devices.session_devices import Devices, OpenCamera
from rig.instrument import optics_of, prepare_kernels
from rig.settings import Configuration
from rig.terminal import Keys, answer, say

HELP = "e E exposure   a auto exposure   g G gain   z zoom   s save a picture   q end"
_BELOW_ROWS = 10
_BARS = " ▁▂▃▄▅▆▇█"


def half_blocks(picture: NDArray[np.uint8]) -> Text:
    """A picture (ny, nx, 3) as characters, each of which shows two pixels, one above the other."""
    if picture.shape[0] % 2:
        picture = np.concatenate([picture, np.zeros_like(picture[:1])])
    text = Text(no_wrap=True)
    for upper, lower in zip(picture[0::2], picture[1::2], strict=True):
        for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
            text.append("▀", Style(color=_colour(above), bgcolor=_colour(below)))
        text.append("\n")
    return text


def histogram_line(look: AlignmentFrame, bars: int = 32) -> str:
    """Counts of pixels from 0 to full scale; a bar's height is logarithmic in the count."""
    counts = np.histogram(look.image, bars, (0, look.full_scale_dn + 1))[0]
    height = np.log1p(counts) / np.log1p(counts.max())
    return f"0 {''.join(_BARS[round(8 * one)] for one in height.tolist())} {look.full_scale_dn} DN"


def _colour(rgb: list[int]) -> str:
    return f"#{rgb[0]:02x}{rgb[1]:02x}{rgb[2]:02x}"


_EXPOSURE_STEP = 1.25
_GAIN_STEP_DB = 1.0
_ZOOMS = (1.0, 4.0, 16.0)
_PICTURE_PX = (1200, 900)
_PREFIX, _END = "align", ("q", "escape")
_LOOK_S, _SHOWN_EACH_S = 0.1, 0.2
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
        self._lit_s = 0.0

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

    def show(
        self,
        opened: OpenCamera,
        terminal: "AlignmentTerminal",
        *,
        seconds: float = 0.0,
    ) -> None:
        """Light the laser and show the newest frames until a key at the terminal, or the time in s, ends it.

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
            while True:
                self.news.begin_run("live picture", info.full_scale_dn, self._applied)
                self._tell()
                trackers = optics.dual_tracker()
                newest = watch_latest(opened.camera, end_s, _LOOK_S, self._frame_read)
                with closing(newest):
                    for frame in newest:
                        middle_px, applied = self._config.lever_reference_px, self._applied
                        look = take_look(frame.image, info.full_scale_dn, trackers, middle_px, applied)
                        of_reference = None if look.reference is None else look.reference.spot
                        self.news.show(frame.image, look.spot, of_reference, look.beam)
                        watch.look()
                        self._keep_lit_while_seen()
                        terminal.take(look, self)
                        if self.requests.waiting:
                            break
                    else:
                        if time.monotonic() < end_s:
                            raise DeviceError("the camera has delivered its last frame")
                        return
                # a camera is configured while it is stopped, and goes on with the next round
                self.note = self.requests.carry_out()
                if self._over:
                    return
        finally:
            devices.darken("the live picture is closed")

    def press(self, key: str) -> None:
        """Request what a key means."""
        self.requests.put(partial(self._press, key))

    def _light(self) -> str:
        """Light; what was done, or why the picture lives in the dark until somebody acknowledges and asks."""
        self._left, self._lit_s = False, time.monotonic()
        try:
            return self._devices.light()
        except LightRefused as refused:
            return str(refused)

    def _frame_read(self, frame: Frame) -> None:
        """Tell the laser's permit of a frame, at which the reader looks at once."""
        self._devices.permit.frame_read(frame.image)
        self._devices.permit.note_progress(Stage.PROCESSING)

    def _keep_lit_while_seen(self) -> None:
        """Switch the laser off once nobody looks at the desk that shows it, or the desk is gone."""
        devices, news, now_s = self._devices, self.news, time.monotonic()
        if devices.permit.begun and news.asked_s > 0.0 and not at_terminal():
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
        self._over = self._over or key in _END
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


class AlignmentTerminal:
    """The terminal of a live picture, a context manager; keys save pictures in `folder`, which are `saved`.

    They are named align-1.png and so on; none is overwritten.
    """

    def __init__(self, folder: Path, keys: Keys | None = None, console: Console | None = None) -> None:
        self._folder = folder
        self._keys = Keys() if keys is None else keys
        self._console = Console() if console is None else console
        self._live = (
            Live(console=self._console, auto_refresh=False) if self._console.is_terminal else nullcontext()
        )
        self._zoom, self._shown_s = 0, 0.0
        self.saved: list[Path] = []

    def __enter__(self) -> Self:
        self._keys.__enter__()
        self._live.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._live.__exit__(*error)
        self._keys.__exit__(*error)

    def take(self, look: AlignmentFrame, picture: LivePicture) -> None:
        """Show a frame with its figures and a note, and take account of keys."""
        for key in self._keys.pressed(0.0):
            if key == "z":
                self._zoom = (self._zoom + 1) % len(_ZOOMS)
            elif key == "s":
                self.saved.append(_save(look, self._folder, _ZOOMS[self._zoom]))
                picture.note = f"{self.saved[-1]} saved"
            else:
                picture.press(key)
        answer(picture=tuple(look.lines()), beam=look.beam_line)  # the last one stays
        if time.monotonic() - self._shown_s >= _SHOWN_EACH_S:
            self._shown_s = time.monotonic()
            self._show(look, picture.dark or picture.note)

    def _show(self, look: AlignmentFrame, note: str) -> None:
        """Show a frame with its figures and a note; without a terminal as one line."""
        if not isinstance(self._live, Live):
            shown = filter(None, [*look.lines(), look.beam_line, note])
            self._console.print("  ".join(shown), soft_wrap=True, highlight=False)
            return
        size, zoom = self._console.size, _ZOOMS[self._zoom]
        picture = annotated_picture(look, size.width, 2 * max(size.height - _BELOW_ROWS, 4), zoom)
        keys_help = HELP if self._keys.available else "Ctrl-C ends"
        lines = [f"zoom {zoom:g}  {histogram_line(look)}", *look.lines(), look.beam_line, note, keys_help]
        text = Text("\n".join(lines), no_wrap=True, overflow="ellipsis")
        self._live.update(Group(half_blocks(picture), text), refresh=True)


def align_camera(config: Configuration, *, folder: Path, seconds: float = 0.0) -> list[Path]:
    """Open the rig and show the live picture, at the terminal and to a desk; returns the pictures saved."""
    output = config.session.output
    with Devices(config, output, "rig camera align") as devices:
        picture = LivePicture(config, devices)
        with (
            light_shown_to_desk(devices, output, picture.news, picture.orders),
            devices.camera(config) as opened,
        ):
            ask_leave(devices)
            with AlignmentTerminal(folder) as terminal:
                picture.show(opened, terminal, seconds=seconds)
            return terminal.saved


def _save(look: AlignmentFrame, folder: Path, zoom: float) -> Path:
    number = 1
    while (path := folder / f"{_PREFIX}-{number}.png").exists():
        number += 1
    atomic_write.write_new(path, png_of(annotated_picture(look, *_PICTURE_PX, zoom)[..., ::-1], path))
    return path
