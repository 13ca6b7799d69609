"""Positions of a spot, or of a dark object, tracked through a film or a folder of images."""

import math
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from acquisition.camera import CameraSettings, Image
from acquisition.cameras.files.camera import FilesCamera
from acquisition.cameras.files.frame_source import FilesSettings
from acquisition.cameras.files.sources import IMAGES, images_in, is_film, natural_key
from processing.arrays import Flags, Floats, Ints
from processing.errors import ConfigurationError, DataError
from processing.spot import SensorModel, Spot, SpotFlag, SpotTracker, fixed_light
from processing.units import conversion, seconds
from rig.intake.trajectory import ANGLE_UNITS, Trajectory
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
_U_LOSSY_OVER_NOISE = 1.0
"""Common standard uncertainty of amplitudes in compressed films over the noise of one position: in H.264,
H.265 and MPEG-4 of known swings (crf 8 to 28, periods 1.7 and 4 s) they were too small by 0 to 0.07 px, which
is 0.1 to 1.8 of that noise."""
_WHITE = "GROUND_SATURATED"
"""Flag of frames in which the ground of a dark object is saturated, which distorts the shape of its edges."""
_MAX_LOST_FRACTION = 0.5
"""Fraction of frames without a position above which the tracked object is hardly the pendulum."""
_MAX_PICTURES, _MAX_PICTURES_BYTES = 64, 1 << 28
"""Largest number and size of the pictures, evenly spread over the film, in which fixed light is sought."""
_SUBDIVISIONS, _MAX_SUBDIVIDED_DN = 16, 4095
"""Subdivisions of a grey value after subtraction of fixed light, and the largest full scale for them."""
_MAX_COMPRESSION_TRACE: Final = 0.015
"""Fraction of the spot's light that strong compression may leave along its path: 0.007 at crf 28."""


@dataclass(frozen=True, slots=True)
class FilmOptions:
    """Options for reading a film."""

    rate_hz: float | None = None
    """Frame rate, for images without times, or with `force` in place of the film's own times."""
    force: bool = False
    dark: bool | None = None
    """Whether the object is darker than its ground; None: the first frame decides."""
    size: str = ""
    """Size of a pixel with its unit (``0.142 mm``, ``3.2 arcsec``); empty: px."""
    begin_s: float | None = None
    """Begin of the stretch that is used, in s since the first frame; None: the first frame."""
    end_s: float | None = None
    """End of that stretch, in s since the first frame; None: the last frame."""


def film_trajectory(
    path: Path, options: FilmOptions, progress: Callable[[int, int], None] | None = None
) -> Trajectory:
    """Track the spot through a film; `progress` is called with the numbers of frames done and of all frames.

    Raises DeviceError for a film that does not exist or cannot be read correctly, DataError if most frames
    have nothing to track, and ConfigurationError for an invalid size of a pixel.
    """
    factor, unit = _pixel(options.size)
    stated = {"path": path, "frame_rate_hz": options.rate_hz, "force_frame_rate": options.force}
    camera = FilesCamera(FilesSettings.model_validate({**stated, "colour": "brightness"}))
    full_dn = camera.open().full_scale_dn
    try:
        camera.configure(CameraSettings())
        tracked, light_remark = _track(camera, full_dn, options, progress), ""
        light = None if tracked.dark else fixed_light(tracked.sampled)
        if light is not None and not (camera.lossy and light.relative_height < _MAX_COMPRESSION_TRACE):
            light_remark = light.text
            without_light = _track(camera, full_dn, options, progress, light.light_dn)
            if without_light.flags["LOST"] <= tracked.flags["LOST"]:
                tracked, light_remark = without_light, f"{light.text}; taken off"
        status = camera.status
    finally:
        camera.close()
    flags = tracked.flags
    since_ns = np.array(tracked.times_ns, dtype=np.int64) - tracked.times_ns[0]
    missing = f"{status.dropped_by_camera} missing, {status.incomplete} damaged or of another size"
    kind = "a dark object (the picture is inverted)" if tracked.dark else "a bright spot"
    summary = f"followed: {kind}; {flags['LOST']} frames without one" + _flag_text(flags, status.delivered)
    lines = [
        *camera.remarks,
        *([_LOSSY.format(camera.lossy)] if camera.lossy else []),
        f"frames: {status.delivered} read, {missing}",
        summary,
        *filter(None, [light_remark]),
        f"position: x and y, in {unit}"
        + (f", a pixel is {factor:.6g} {unit}" if options.size else "")
        + (", x counted in pixels as a viewer shows them" if camera.pixel_aspect != 1.0 else ""),
    ]
    if flags["LOST"] > _MAX_LOST_FRACTION * status.delivered:
        raise DataError(
            f"{path}: in {flags['LOST']} of {status.delivered} frames there is nothing to follow; a bright "
            "spot on a dark ground or a dark object on an even one is needed (--dark, --bright), 2 px across "
            "or more at half its light"
        )
    xy = np.array(tracked.positions)
    # the centre of the first pixel is at 0, its left edge at -1/2
    xy[:, 0] = camera.pixel_aspect * (xy[:, 0] + 0.5) - 0.5
    inside = _inside(path, seconds(since_ns), options)
    return Trajectory(
        times_ns=since_ns[inside],
        positions=tuple((factor * xy[inside]).T),
        names=("x", "y"),
        unit=unit,
        scale_rad=conversion(unit, "rad") if unit in ANGLE_UNITS else None,
        time_name="the film's times" if options.rate_hz is None else "the stated rate",
        understood=tuple(lines),
        u_common_over_noise=_U_LOSSY_OVER_NOISE if camera.lossy else 0.0,
        remedy=f"{summary.capitalize()}, {_extent(xy[inside])}; --dark, --bright, --from and --to choose "
        "something else",
    )


@dataclass
class _TrackedFilm:
    """What the tracking of a film has found."""

    dark: bool
    """Whether the object is darker than its ground."""
    times_ns: list[int] = field(default_factory=list)
    positions: list[tuple[float, float]] = field(default_factory=list)
    """x and y in every frame, in px; NaN where the object is lost."""
    flags: Counter[str] = field(default_factory=Counter)
    """Numbers of frames with each flag."""
    sampled: list[tuple[Image, Spot]] = field(default_factory=list)
    """Pictures and spots of some frames."""


def _track(
    camera: FilesCamera,
    full_dn: int,
    options: FilmOptions,
    progress: Callable[[int, int], None] | None,
    fixed_dn: Floats | None = None,
) -> _TrackedFilm:
    """Track the pendulum through all frames; `fixed_dn` is fixed light to be subtracted, in DN."""
    camera.start()
    subdivisions = _SUBDIVISIONS if fixed_dn is not None and full_dn <= _MAX_SUBDIVIDED_DN else 1
    film: _TrackedFilm | None = None
    stride = 1
    while (frame := camera.read(1.0)) is not None:
        if film is None:
            film = _TrackedFilm(has_dark_object(frame.image) if options.dark is None else options.dark)
            tracker = SpotTracker(_sensor(full_dn * subdivisions, subdivisions, dark=film.dark))
        image = inverted(frame.image, full_dn) if film.dark else frame.image
        if fixed_dn is not None:
            remainder = np.rint(subdivisions * np.clip(image - fixed_dn, 0.0, full_dn))
            image = np.where(image >= full_dn, full_dn * subdivisions, remainder).astype(np.uint16)
        spot, sampled = tracker.track(image), film.sampled
        if len(film.times_ns) % stride == 0:
            sampled.append((image, spot))
            if len(sampled) == _MAX_PICTURES or len(sampled) * image.nbytes > _MAX_PICTURES_BYTES:
                stride *= 2
                del sampled[1::2]
        film.times_ns.append(frame.device_time_ns or 0)
        film.positions.append((spot.x_px, spot.y_px))
        film.flags.update(flag.name or "" for flag in SpotFlag(spot.flags))
        if film.dark:
            film.flags[_WHITE] += int(2 * np.count_nonzero(frame.image >= full_dn) > frame.image.size)
        if progress is not None:
            progress(len(film.times_ns), camera.count)
    camera.stop()
    assert film is not None
    return film


def is_filmed(path: Path) -> bool:
    """Whether a path is a film, an image or a stack of images, or a folder of them, by names."""
    if path.is_dir():
        return bool(images_in([file.name for file in path.iterdir()])) or bool(films_in(path))
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
    files = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
    if images_in([file.name for file in files]):
        return []
    return sorted(filter(is_film, files), key=lambda file: natural_key(file.name))


def _extent(xy: Floats) -> str:
    """The range of the tracked positions in px, in words."""
    with warnings.catch_warnings():
        # a coordinate that is lost in all frames has no range, which is no reason for a warning
        warnings.simplefilter("ignore")
        low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    return " and ".join(f"{name} {a:.4g} to {b:.4g} px" for name, a, b in zip("xy", low, high, strict=True))


def has_dark_object(image: Image) -> bool:
    """Whether the object in a picture is darker than its ground."""
    low, median, high = np.percentile(image, [0.1, 50.0, 99.9])
    return bool(median - low > _MIN_DARK_RATIO * (high - median))


def _sensor(full_scale_dn: int, noise_dn: int = 1, *, dark: bool) -> SensorModel:
    """Sensor model of a film; in an inverted picture full scale is black, and so no saturation."""
    gain = _WELL_E / full_scale_dn
    return SensorModel(gain, gain * noise_dn, 2.0 * full_scale_dn if dark else full_scale_dn)


def inverted(image: Image, full_scale_dn: int) -> Image:
    """The negative of an image; pixels above full scale become black."""
    negative: Ints = full_scale_dn - np.minimum(image, full_scale_dn).astype(np.int64)
    return np.asarray(negative.astype(image.dtype))


def _flag_text(flags: Counter[str], count: int) -> str:
    """Flags that more than 5 % of the frames have, in words."""
    texts = [
        f"{name.lower().replace('_', ' ')} in {100 * flags[name] / count:.0f} %"
        for name in ("SATURATED", _WHITE, "EDGE", "CUT", "POOR_FIT", "MULTIPLE")
        if flags[name] > 0.05 * count
    ]
    return f"; {', '.join(texts)}" if texts else ""


def _pixel(text: str) -> tuple[float, str]:
    """Size of a pixel and its unit, stated directly or as a length over a number of pixels."""
    if not text:
        return 1.0, "px"
    length, over, pixels = text.partition(" over ")
    number, _, unit_text = length.strip().partition(" ")
    count, _, px = pixels.strip().partition(" ")
    unit = known_unit(unit_text)
    try:
        size = float(number) / (float(count) if over else 1.0)
    except (ValueError, ZeroDivisionError):
        size = 0.0
    if not unit or not 0 < size < math.inf or (over and known_unit(px) != "px"):
        raise ConfigurationError(
            f"--pixel {text!r}: a number and a unit are needed, as '0.142 mm' or '3.2 arcsec', or a length "
            "over its pixels: '85 mm over 600 px'"
        )
    return size, unit


def _inside(path: Path, since_s: Floats, options: FilmOptions) -> Flags:
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
