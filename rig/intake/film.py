"""Positions of a spot, or of a dark object, followed through a film or a folder of images."""

import math
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import CameraSettings, Image
from acquisition.cameras.files.camera import FilesCamera
from acquisition.cameras.files.frame_source import FilesSettings
from acquisition.cameras.files.sources import IMAGES, images_in, is_film, natural_key
from processing.arrays import Floats
from processing.errors import ConfigurationError, DataError
from processing.spot import SensorModel, Spot, SpotFlag, SpotTracker, fixed_light
from processing.units import conversion, seconds
from rig.intake.trajectory import ANGLES, Trajectory
from rig.intake.units import known_unit

_MIN_DARK_RATIO = 1.5
"""Distance of the darkest pixels from the median over that of the brightest that shows a dark object."""
_WELL_E = 10_000.0
"""Assumed full well of a pixel: that of a typical small sensor. It only weights pixels, because the
uncertainty of positions is later taken from their scatter."""
_LOSSY = (
    "compression ({}): the uncertainties include its noise, and a common error of all amplitudes as large "
    "as the noise of one position"
)
_U_LOSSY_IN_NOISES = 1.0
"""Common standard uncertainty of amplitudes in compressed films, in units of the noise of one position: in
H.264, H.265 and MPEG-4 of known swings (crf 8 to 28, periods 1.7 and 4 s) they were too small by 0 to 0.07
px, which is 0.1 to 1.8 of that noise."""
_WHITE = "GROUND_SATURATED"
"""Flag of frames in which the ground of a dark object is saturated, which distorts the shape of its edges."""
_MIN_FOUND_FRACTION = 0.5
"""Fraction of frames with a position below which the followed object is hardly the pendulum."""
_MAX_PICTURES, _MAX_PICTURES_BYTES = 64, 1 << 28
"""Limits of the pictures that are kept, evenly spread over the film, to find fixed light."""
_SUBDIVISIONS, _MAX_SUBDIVIDED_DN = 16, 4095
"""Subdivisions of a grey value after subtraction of fixed light, and the largest full scale for them."""
_MAX_COMPRESSION_TRACE: Final = 0.015
"""Fraction of the spot's light that strong compression may leave along its path: 0.007 at crf 28."""


@dataclass(frozen=True, slots=True)
class FilmOptions:
    """Options for reading a film.

    `size` is the size of a pixel with its unit (``0.142 mm``, ``3.2 arcsec``); empty: px. `rate_hz` is the
    frame rate, for images without times, or with `force` in place of the film's own times. `dark` tells
    whether the object is darker than its ground; None: the first frame decides.
    """

    rate_hz: float | None = None
    force: bool = False
    dark: bool | None = None
    size: str = ""
    begin_s: float | None = None
    end_s: float | None = None


def film_trajectory(
    path: Path, options: FilmOptions, progress: Callable[[int, int], None] | None = None
) -> Trajectory:
    """Follow the spot through a film; `progress` is called with the numbers of frames done and of all frames.

    Raises
    ------
    DeviceError
        There is no film, or it cannot be read correctly.
    DataError
        Most frames have nothing to follow.
    ConfigurationError
        The size of a pixel is invalid.
    """
    factor, unit = _pixel(options.size)
    settings = FilesSettings.model_validate(
        {
            "path": path,
            "frame_rate_hz": options.rate_hz,
            "force_frame_rate": options.force,
            "colour": "brightness",
        }
    )
    camera = FilesCamera(settings)
    full_dn = camera.open().full_scale_dn
    try:
        camera.configure(CameraSettings())
        seen = _follow(camera, full_dn, options, progress)
        light = None if seen.dark else fixed_light(seen.sampled)
        if light is not None and camera.lossy and light.relative_height < _MAX_COMPRESSION_TRACE:
            light = None
        without_light = None if light is None else _follow(camera, full_dn, options, progress, light.light_dn)
        status = camera.status
    finally:
        camera.close()
    light_remarks = [] if light is None else [light.text]
    if without_light is not None and without_light.flags["LOST"] <= seen.flags["LOST"]:
        seen, light_remarks = without_light, [f"{line}; taken off" for line in light_remarks]
    flags = seen.flags
    since_ns = np.array(seen.times_ns, dtype=np.int64) - seen.times_ns[0]
    lost = f"{status.dropped_by_camera} missing, {status.incomplete} damaged or of another size"
    followed = "a dark object (the picture is inverted)" if seen.dark else "a bright spot"
    what = f"followed: {followed}; {flags['LOST']} frames without one" + _flag_text(flags, status.delivered)
    lines = [
        *camera.remarks,
        *([_LOSSY.format(camera.lossy)] if camera.lossy else []),
        f"frames: {status.delivered} read, {lost}",
        what,
        *light_remarks,
        f"position: x and y, in {unit}"
        + (f", a pixel is {factor:.6g} {unit}" if options.size else "")
        + (", x counted in pixels as a viewer shows them" if camera.pixel_aspect != 1.0 else ""),
    ]
    if flags["LOST"] > (1.0 - _MIN_FOUND_FRACTION) * status.delivered:
        raise DataError(
            f"{path}: in {flags['LOST']} of {status.delivered} frames there is nothing to follow; a bright "
            "spot on a dark ground or a dark object on an even one is needed (--dark, --bright), 2 px across "
            "or more at half its light"
        )
    xy = np.array(seen.places)
    # the centre of the first pixel is at 0, its left edge at -1/2
    xy[:, 0] = camera.pixel_aspect * (xy[:, 0] + 0.5) - 0.5
    inside = _inside(path, seconds(since_ns), options)
    return Trajectory(
        times_ns=since_ns[inside],
        positions=tuple((factor * xy[inside]).T),
        names=("x", "y"),
        unit=unit,
        scale_rad=conversion(unit, "rad") if unit in ANGLES else None,
        time_name="the film's times" if options.rate_hz is None else "the stated rate",
        understood=tuple(lines),
        u_common_in_noises=_U_LOSSY_IN_NOISES if camera.lossy else 0.0,
        remedy=f"{what.capitalize()}, {_extent(xy[inside])}; --dark, --bright, --from and --to choose "
        "something else",
    )


@dataclass
class _TrackedFilm:
    """A film as it was followed: time and position of every frame, picture and spot of some."""

    dark: bool
    times_ns: list[int] = field(default_factory=list)
    places: list[tuple[float, float]] = field(default_factory=list)
    flags: Counter[str] = field(default_factory=Counter)
    sampled: list[tuple[Image, Spot]] = field(default_factory=list)


def _follow(
    camera: FilesCamera,
    full_dn: int,
    options: FilmOptions,
    progress: Callable[[int, int], None] | None,
    fixed_dn: Floats | None = None,
) -> _TrackedFilm:
    """Follow the pendulum through all frames; `fixed_dn` is fixed light to be subtracted, in DN."""
    camera.start()
    fine = _SUBDIVISIONS if fixed_dn is not None and full_dn <= _MAX_SUBDIVIDED_DN else 1
    found: _TrackedFilm | None = None
    every = 1
    while (frame := camera.read(1.0)) is not None:
        if found is None:
            found = _TrackedFilm(has_dark_object(frame.image) if options.dark is None else options.dark)
            tracker = SpotTracker(_sensor(full_dn * fine, fine, dark=found.dark))
        image = inverted(frame.image, full_dn) if found.dark else frame.image
        if fixed_dn is not None:
            rest = np.rint(fine * np.clip(image - fixed_dn, 0.0, full_dn))
            image = np.where(image >= full_dn, full_dn * fine, rest).astype(np.uint16)
        spot = tracker.track(image)
        if len(found.times_ns) % every == 0:
            found.sampled.append((image, spot))
            if len(found.sampled) == _MAX_PICTURES or len(found.sampled) * image.nbytes > _MAX_PICTURES_BYTES:
                every *= 2
                del found.sampled[1::2]
        found.times_ns.append(frame.device_time_ns or 0)
        found.places.append((spot.x_px, spot.y_px))
        found.flags.update(flag.name or "" for flag in SpotFlag(spot.flags))
        if found.dark:
            found.flags[_WHITE] += int(2 * np.count_nonzero(frame.image >= full_dn) > frame.image.size)
        if progress is not None:
            progress(len(found.times_ns), camera.count)
    camera.stop()
    assert found is not None
    return found


def is_filmed(path: Path) -> bool:
    """Whether a path is a film, an image or a stack of images, or a folder of them, by names."""
    if path.is_dir():
        return bool(images_in([each.name for each in path.iterdir()])) or bool(films_in(path))
    if path.suffix.lower() == ".npy":
        try:
            return bool(np.load(path, mmap_mode="r").ndim > 2)
        except (OSError, ValueError):
            return False
    return path.suffix.lower() in IMAGES or is_film(path)


def films_in(path: Path) -> list[Path]:
    """The films of a folder, in natural order of their names; empty for a file, or a folder of images."""
    if not path.is_dir():
        return []
    inside = [each for each in path.iterdir() if each.is_file() and not each.name.startswith(".")]
    if images_in([each.name for each in inside]):
        return []
    return sorted(filter(is_film, inside), key=lambda each: natural_key(each.name))


def _extent(xy: NDArray[np.float64]) -> str:
    """The range of the followed positions in px, in words."""
    with warnings.catch_warnings():
        # a coordinate that is lost in all frames has no range, which is no reason for a warning
        warnings.simplefilter("ignore")
        low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    return " and ".join(f"{name} {a:.4g} to {b:.4g} px" for name, a, b in zip("xy", low, high, strict=True))


def has_dark_object(image: Image) -> bool:
    """Whether the object in a picture is darker than its ground."""
    low, middle, high = np.percentile(image, [0.1, 50.0, 99.9])
    return bool(middle - low > _MIN_DARK_RATIO * (high - middle))


def _sensor(full_scale_dn: int, noise_dn: int = 1, *, dark: bool) -> SensorModel:
    """Sensor model of a film; in an inverted picture full scale is black, and so no saturation."""
    gain = _WELL_E / full_scale_dn
    return SensorModel(gain, gain * noise_dn, 2.0 * full_scale_dn if dark else full_scale_dn)


def inverted(image: Image, full_scale_dn: int) -> Image:
    """The negative of an image; pixels above full scale become black."""
    turned: NDArray[np.int64] = full_scale_dn - np.minimum(image, full_scale_dn).astype(np.int64)
    return np.asarray(turned.astype(image.dtype))


def _flag_text(flags: Counter[str], count: int) -> str:
    """Flags that more than 5 % of the frames have, in words."""
    doubts = [
        f"{name.lower().replace('_', ' ')} in {100 * flags[name] / count:.0f} %"
        for name in ("SATURATED", _WHITE, "EDGE", "CUT", "POOR_FIT", "MULTIPLE")
        if flags[name] > 0.05 * count
    ]
    return f"; {', '.join(doubts)}" if doubts else ""


def _pixel(text: str) -> tuple[float, str]:
    """Size of a pixel and its unit, stated directly or as a length over a number of pixels."""
    if not text:
        return 1.0, "px"
    whole, over, count = text.partition(" over ")
    number, _, unit = whole.strip().partition(" ")
    pixels, _, px = count.strip().partition(" ")
    known = known_unit(unit)
    try:
        size = float(number) / (float(pixels) if over else 1.0)
    except (ValueError, ZeroDivisionError):
        size = 0.0
    if not known or not 0 < size < math.inf or (over and known_unit(px) != "px"):
        raise ConfigurationError(
            f"--pixel {text!r}: a number and a unit are needed, as '0.142 mm' or '3.2 arcsec', or a length "
            "over its pixels: '85 mm over 600 px'"
        )
    return size, known


def _inside(path: Path, since_s: NDArray[np.float64], options: FilmOptions) -> NDArray[np.bool_]:
    begin_s = 0.0 if options.begin_s is None else options.begin_s
    end_s = float(since_s[-1]) if options.end_s is None else options.end_s
    inside = (since_s >= begin_s) & (since_s <= end_s)
    if len(since_s) < 2:
        raise DataError(f"{path}: one frame of it can be read; a film of ten periods or more is needed")
    if np.count_nonzero(inside) < 2:
        raise ConfigurationError(
            f"--from {begin_s:g} --to {end_s:g} leaves no frames of 0 to {since_s[-1]:.6g} s"
        )
    return np.asarray(inside)
