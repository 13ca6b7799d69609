"""Alignment of laser and camera by eye: shows the newest frames at a terminal until the user ends it."""

import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.style import Style
from rich.text import Text

from acquisition import atomic_write
from acquisition.camera import Camera, CameraInfo, CameraSettings, Frame
from processing.errors import DeviceError
from processing.spot import Spot, SpotTracker
from processing.units import nanoseconds
from rig.devices.alignment_look import AlignmentFrame, annotated_picture, take_look
from rig.devices.picture import png_of, watch_latest
from rig.terminal import Keys, answer

HELP = "e E exposure   g G gain   z zoom   s save a picture   q end"
_BELOW_ROWS = 10
_BARS = " ▁▂▃▄▅▆▇█"


def _show(
    console: Console, live: Live | None, look: AlignmentFrame, zoom: float, note: str, keys_help: str
) -> None:
    """Show a frame with its figures, at this zoom, with a note; without a terminal as one line."""
    if live is None:
        shown = filter(None, [*look.lines(), look.beam_line, note])
        console.print("  ".join(shown), soft_wrap=True, highlight=False)
        return
    size = console.size
    picture = annotated_picture(look, size.width, 2 * max(size.height - _BELOW_ROWS, 4), zoom)
    lines = [f"zoom {zoom:g}  {histogram_line(look)}", *look.lines(), look.beam_line, note, keys_help]
    text = Text("\n".join(lines), no_wrap=True, overflow="ellipsis")
    live.update(Group(half_blocks(picture), text), refresh=True)


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
_PREFIX = "align"


def align_camera(
    camera: Camera,
    info: CameraInfo,
    applied: CameraSettings,
    tracker: SpotTracker,
    *,
    folder: Path,
    reference: tuple[SpotTracker, int] | None = None,
    reference_px: tuple[float, float] | None = None,
    seconds: float = 0.0,
    view: Callable[[Frame, Spot], None] | None = None,
    keys: Keys | None = None,
    console: Console | None = None,
) -> list[Path]:
    """Show the newest frames five times a second, until a key or the time ends it.

    Parameters
    ----------
    camera
        Open, configured and stopped; it is stopped again afterwards and keeps what the keys have set.
    applied
        Settings that hold in the camera, as read back.
    folder
        Folder for the pictures that the key `s` saves, align-1.png and so on; none is overwritten.
    reference
        Tracker of the reference spot, and the first row of the frame that belongs to the reference.
    reference_px
        Position (x, y) at which the spot should rest; default: the middle of the frame.
    view
        Called with each shown frame, timed from the beginning, and the spot in it.
    seconds
        Duration in s; 0: until the key `q`, or Ctrl-C.

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
    live = Live(console=console, auto_refresh=False) if console.is_terminal else None
    with terminal, live or nullcontext():
        keys_help = HELP if terminal.available else "Ctrl-C ends"
        going = True
        while going:
            going, wanted = False, None
            for *_, frame in watch_latest(camera, 1, end_s):
                look = take_look(frame.image, info.full_scale_dn, tracker, reference_px, applied, reference)
                if view is not None:
                    at_ns = nanoseconds(time.monotonic() - begun_s)
                    view(frame._replace(device_time_ns=at_ns), look.spot)
                for key in terminal.pressed(0.0):
                    if key in ("q", "escape"):
                        return saved
                    if key == "z":
                        zoom = (zoom + 1) % len(_ZOOMS)
                    elif key == "s":
                        saved.append(_save(look, folder, _ZOOMS[zoom]))
                        note = f"{saved[-1]} saved"
                    else:
                        wanted = _requested_settings(key, applied) or wanted
                _show(console, live, look, _ZOOMS[zoom], note, keys_help)
                answer(picture=tuple(look.lines()), beam=look.beam_line)  # the last one stays
                if wanted is not None:
                    break
            if wanted is not None:
                # the camera was stopped to be configured, and starts again in the next round
                applied, note = _configured(camera, applied, wanted)
                going = True
    return saved


def _requested_settings(key: str, applied: CameraSettings) -> CameraSettings | None:
    """The setting that a key requests; None for another key, and for one that the camera does not have."""
    if key in "eE" and applied.exposure_us is not None:
        factor = _EXPOSURE_STEP if key == "E" else 1 / _EXPOSURE_STEP
        return CameraSettings(exposure_us=applied.exposure_us * factor)
    if key in "gG" and applied.gain_db is not None:
        return CameraSettings(gain_db=applied.gain_db + (_GAIN_STEP_DB if key == "G" else -_GAIN_STEP_DB))
    return None


def _configured(camera: Camera, before: CameraSettings, wanted: CameraSettings) -> tuple[CameraSettings, str]:
    """The settings read back, and a note on what the camera has not set."""
    name = "gain" if wanted.exposure_us is None else "exposure"
    try:
        applied = camera.configure(wanted)
    except DeviceError as error:
        return before, f"{name}: {error}"
    return applied, "" if applied != before else f"the {name} is at the camera's limit"


def _save(look: AlignmentFrame, folder: Path, zoom: float) -> Path:
    number = 1
    while (path := folder / f"{_PREFIX}-{number}.png").exists():
        number += 1
    atomic_write.write_new(path, png_of(annotated_picture(look, *_PICTURE_PX, zoom)[..., ::-1], path))
    return path
