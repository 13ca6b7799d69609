"""Aligns laser and camera by eye: looks at the newest frames until the user ends it."""

import time
from pathlib import Path
from typing import NamedTuple

import cv2
from rich.console import Console

from acquisition.camera import Camera, CameraInfo, CameraSettings
from acquisition.frame_queue import FrameQueue
from processing.errors import ConfigurationError, DeviceError
from processing.spot import SpotTracker
from rig.align.aligning_screen import HELP, AligningScreen
from rig.align.annotated_picture import annotated_picture
from rig.align.look import AlignmentFrame, take_look
from rig.devices import watch_latest
from rig.presentation import Keys
from rig.view import Viewer

_EXPOSURE_STEP = 1.25
_GAIN_STEP_DB = 1.0
_ZOOMS = (1.0, 4.0, 16.0)
_PICTURE_PX = (1200, 900)
_PREFIX = "align"


class _Wish(NamedTuple):
    """What a key asks of the camera."""

    settings: CameraSettings
    note: str


def align_camera(
    camera: Camera,
    info: CameraInfo,
    applied: CameraSettings,
    tracker: SpotTracker,
    *,
    folder: Path,
    reference_px: tuple[float, float] | None = None,
    seconds: float = 0.0,
    viewer: Viewer | None = None,
    keys: Keys | None = None,
    console: Console | None = None,
) -> list[Path]:
    """Show the newest frames five times a second, until a key or the time ends it.

    Parameters
    ----------
    camera
        Open, configured and stopped; it is stopped again afterwards and keeps what the keys have set.
    applied
        Settings that the camera has read back.
    folder
        Where the key `s` puts its pictures, align-1.png and so on; none is written over.
    reference_px
        Where the spot should rest, (x, y); default: the middle of the frame.
    seconds
        End after this many; 0: at the key `q`, or at Ctrl-C.

    Returns
    -------
    list
        The pictures that were saved.
    """
    begun_s = time.monotonic()
    end_s = begun_s + seconds if seconds else float("inf")
    zoom, note = 0, ""
    saved: list[Path] = []
    terminal = Keys() if keys is None else keys
    console = Console() if console is None else console
    with terminal, AligningScreen(console, HELP if terminal.there else "Ctrl-C ends") as screen:
        going = True
        while going:
            going, wish = False, None
            for *_, frame in watch_latest(camera, FrameQueue(1, "latest"), 1, end_s):
                look = take_look(frame.image, info.full_scale_dn, tracker, reference_px, applied)
                if viewer is not None:
                    viewer.image(time.monotonic() - begun_s, frame.image, (look.spot.x_px, look.spot.y_px))
                for key in terminal.pressed(0.0):
                    if key in ("q", "escape"):
                        return saved
                    if key == "z":
                        zoom = (zoom + 1) % len(_ZOOMS)
                    elif key == "s":
                        saved.append(_save(look, folder, _ZOOMS[zoom]))
                        note = f"{saved[-1]} saved"
                    else:
                        wish = _wish_of(key, applied) or wish
                screen.show(look, _ZOOMS[zoom], note)
                if wish is not None:
                    break
            if wish is not None:
                # a camera is configured while it is stopped, and goes on with the next look
                applied, note = _configured(camera, applied, wish)
                going = True
    return saved


def _wish_of(key: str, applied: CameraSettings) -> _Wish | None:
    if key in "eE" and applied.exposure_us is not None:
        wanted_us = applied.exposure_us * (_EXPOSURE_STEP if key == "E" else 1 / _EXPOSURE_STEP)
        return _Wish(CameraSettings(exposure_us=wanted_us), "exposure")
    if key in "gG" and applied.gain_db is not None:
        wanted_db = applied.gain_db + (_GAIN_STEP_DB if key == "G" else -_GAIN_STEP_DB)
        return _Wish(CameraSettings(gain_db=wanted_db), "gain")
    return None


def _configured(camera: Camera, before: CameraSettings, wish: _Wish) -> tuple[CameraSettings, str]:
    try:
        applied = camera.configure(wish.settings)
    except DeviceError as error:
        return before, f"{wish.note}: {error}"
    return applied, "" if applied != before else f"the {wish.note} is at the camera's limit"


def _save(look: AlignmentFrame, folder: Path, zoom: float) -> Path:
    number = 1
    while (path := folder / f"{_PREFIX}-{number}.png").exists():
        number += 1
    done, png = cv2.imencode(".png", annotated_picture(look, *_PICTURE_PX, zoom)[..., ::-1])
    if not done:
        raise ConfigurationError(f"{path}: can't be written as PNG")
    with path.open("xb") as file:
        file.write(png.tobytes())
    return path
