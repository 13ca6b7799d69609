"""Positions of the spot, or of a dark object, in a film or a folder of images: a trajectory in px."""

import math
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
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

_DARK = 1.5
"""How much further the darkest pixels are from the middle than the brightest where the object is dark."""
_WELL_E = 10_000.0
"""Electrons of a full pixel where nothing states them: a usual small sensor. The uncertainty of positions is
afterwards taken from their scatter, so that this only weighs pixels."""
_LOSSY = (
    "compression ({}): the uncertainties include its noise, and a common error of all amplitudes as large "
    "as the noise of one position"
)
_U_LOSSY_IN_NOISES = 1.0
"""Of H.264, H.265 and MPEG-4 of known swings (crf 8 to 28, periods 1.7 and 4 s) amplitudes were too small
by 0 to 0.07 px, which is 0.1 to 1.8 of the noise of a position in the same film."""
_PLACES = 5
"""That a line names one by one."""
_WHITE = "GROUND_SATURATED"
"""The ground of a dark object is at full scale, which takes its edges' shape."""
_FEWEST_FOUND = 0.5
"""Share of the frames below which what was followed is hardly what swings."""
_BESIDE: Final = 3
"""Neighbours on each side that foretell a position."""
_AROUND: Final = 100
"""Neighbours on each side that say how well they foretell it."""
_USUAL: Final = 0.95
"""Part of them that is taken for usual: compression, which stores nothing where little moves, has tails."""
_TORN: Final = 4.0
"""Times the usual: of noise alone nearly eight standard deviations."""
_SAMPLED, _MOST_BYTES = 64, 1 << 28
"""Most pictures that are kept, evenly spread, to see what stays in them."""
_FINER, _DEEPEST = 16, 4095
"""Parts of a grey value where light is taken off, and the full scale up to which there is room for them."""
_LEFT_BY_COMPRESSION: Final = 0.015
"""Part of the spot that strong compression leaves where it has passed: at crf 28 0.007."""
_LOOKED_AT: Final = 100
"""First frames without a spot in which a point is looked for."""
_POINT_REACH: Final = 4
_CLEAR, _WITHIN, _MAD = 10.0, 0.8, 0.6745
"""A point's height over the noise, the part of its light that is in nine pixels (of a sigma of 0.9 px 0.82),
and the median deviation of normal noise over its standard deviation."""
_LEAST_PX: Final = 0.1
"""A tear that matters nowhere."""


@dataclass(frozen=True, slots=True)
class FilmAsked:
    """How a film is read. `size` is the size of a pixel with its unit (``0.142 mm``, ``3.2 arcsec``); empty:
    px.

    `rate_hz` is the rate where the film's own times do not hold (`force`) or images have none. `dark`: the
    object is darker than its ground; None: it is judged by the first frame.
    """

    rate_hz: float | None = None
    force: bool = False
    colour: str = "brightness"
    dark: bool | None = None
    size: str = ""
    begin_s: float | None = None
    end_s: float | None = None


def film_trajectory(
    path: Path, asked: FilmAsked, progress: Callable[[int, int], None] | None = None
) -> Trajectory:
    """Follow the spot through a film; `progress` is told how many frames of how many are done.

    Raises
    ------
    DeviceError
        No film, or one that cannot be read right.
    DataError
        Nothing to follow in most of its frames.
    ConfigurationError
        A size of a pixel that is none.
    """
    factor, unit = _pixel(asked.size)
    settings = FilesSettings.model_validate(
        {
            "path": path,
            "frame_rate_hz": asked.rate_hz,
            "force_frame_rate": asked.force,
            "colour": asked.colour,
        }
    )
    camera = FilesCamera(settings)
    full_dn = camera.open().full_scale_dn
    try:
        camera.configure(CameraSettings())
        seen = _follow(camera, full_dn, asked, progress)
        light = None if seen.dark else fixed_light(seen.sampled)
        if light is not None and camera.lossy and light.relative_height < _LEFT_BY_COMPRESSION:
            light = None
        taken_off = None if light is None else _follow(camera, full_dn, asked, progress, light.light_dn)
        status = camera.status
    finally:
        camera.close()
    of_light = [] if light is None else [light.text]
    if taken_off is not None and taken_off.flags["LOST"] <= seen.flags["LOST"]:
        seen, of_light = taken_off, [f"{line}; taken off" for line in of_light]
    flags = seen.flags
    since_ns = np.array(seen.times_ns, dtype=np.int64) - seen.times_ns[0]
    lost = f"{status.dropped_by_camera} missing, {status.incomplete} damaged or of another size"
    followed = "a dark object (the picture is inverted)" if seen.dark else "a bright spot"
    what = f"followed: {followed}; {flags['LOST']} frames without one" + _flagged(flags, status.delivered)
    said = [
        *camera.remarks,
        *([_LOSSY.format(camera.lossy)] if camera.lossy else []),
        f"frames: {status.delivered} read, {lost}",
        what,
        *of_light,
        f"position: x and y, in {unit}"
        + (f", a pixel is {factor:.6g} {unit}" if asked.size else "")
        + (", x counted in pixels as a viewer shows them" if camera.pixel_aspect != 1.0 else ""),
    ]
    if flags["LOST"] > (1.0 - _FEWEST_FOUND) * status.delivered:
        if _moves(seen.points):
            raise DataError(
                f"{path}: what moves is smaller than a pixel, which hides where in the pixel it is; a spot "
                "needs 2 px across at half its light (sigma 0.8 px): defocus it, or come nearer"
            )
        raise DataError(
            f"{path}: in {flags['LOST']} of {status.delivered} frames there is nothing to follow; a bright "
            "spot on a dark ground or a dark object on an even one is needed (--dark, --bright)"
        )
    xy = np.array(seen.places)
    # the middle of the first pixel is at 0, its left edge at -1/2
    xy[:, 0] = camera.pixel_aspect * (xy[:, 0] + 0.5) - 0.5
    inside = _inside(path, seconds(since_ns), asked)
    if camera.lossy:
        said += _torn(seconds(since_ns[inside]), xy[inside])
    return Trajectory(
        times_ns=since_ns[inside],
        positions=tuple((factor * xy[inside]).T),
        names=("x", "y"),
        unit=unit,
        scale_rad=conversion(unit, "rad") if unit in ANGLES else None,
        time_name="the film's times" if asked.rate_hz is None else "the stated rate",
        understood=tuple(said),
        u_common_in_noises=_U_LOSSY_IN_NOISES if camera.lossy else 0.0,
        remedy=f"{what.capitalize()}, {_extent(xy[inside])}; --dark, --bright, --from and --to choose "
        "something else",
    )


@dataclass
class _TrackedFilm:
    """What was seen of a film: of every frame its time and place, of some the picture and its spot."""

    dark: bool
    times_ns: list[int] = field(default_factory=list)
    places: list[tuple[float, float]] = field(default_factory=list)
    flags: Counter[str] = field(default_factory=Counter)
    points: list[tuple[int, int] | None] = field(default_factory=list)
    sampled: list[tuple[Image, Spot]] = field(default_factory=list)


def _follow(
    camera: FilesCamera,
    full_dn: int,
    asked: FilmAsked,
    progress: Callable[[int, int], None] | None,
    less: Floats | None = None,
) -> _TrackedFilm:
    """Follow what swings from the first frame to the last, in pictures less some light that stays."""
    camera.start()
    fine = _FINER if less is not None and full_dn <= _DEEPEST else 1
    found: _TrackedFilm | None = None
    every = 1
    while (frame := camera.read(1.0)) is not None:
        if found is None:
            found = _TrackedFilm(looks_dark(frame.image) if asked.dark is None else asked.dark)
            tracker = SpotTracker(_sensor(full_dn * fine, fine, dark=found.dark))
        image = inverted(frame.image, full_dn) if found.dark else frame.image
        if less is not None:
            rest = np.rint(fine * np.clip(image - less, 0.0, full_dn))
            image = np.where(image >= full_dn, full_dn * fine, rest).astype(np.uint16)
        spot = tracker.track(image)
        if spot.flags & SpotFlag.LOST and len(found.points) < _LOOKED_AT:
            found.points.append(point_of(image))
        if len(found.times_ns) % every == 0:
            found.sampled.append((image, spot))
            if len(found.sampled) == _SAMPLED or len(found.sampled) * image.nbytes > _MOST_BYTES:
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
    """Whether a file is a film, images or a stack of them, or a folder holds some: by their names."""
    if path.is_dir():
        return bool(images_in([each.name for each in path.iterdir()])) or bool(films_in(path))
    if path.suffix.lower() == ".npy":
        try:
            return bool(np.load(path, mmap_mode="r").ndim > 2)
        except (OSError, ValueError):
            return False
    return path.suffix.lower() in IMAGES or is_film(path)


def films_in(path: Path) -> list[Path]:
    """The films of a folder, in natural order of their names; none of a file, or a folder of images."""
    if not path.is_dir():
        return []
    inside = [each for each in path.iterdir() if each.is_file() and not each.name.startswith(".")]
    if images_in([each.name for each in inside]):
        return []
    return sorted(filter(is_film, inside), key=lambda each: natural_key(each.name))


def point_of(image: Image) -> tuple[int, int] | None:
    """The brightest pixel, where a spot is that is smaller than a pixel, or about as large."""
    y, x = np.unravel_index(int(np.argmax(image)), image.shape)
    around = image[
        max(y - _POINT_REACH, 0) : y + _POINT_REACH + 1, max(x - _POINT_REACH, 0) : x + _POINT_REACH + 1
    ]
    level = float(np.median(around))
    light = around - level
    core = image[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2] - level
    noise = float(np.median(np.abs(light))) / _MAD + 0.5
    alone = light.max() > _CLEAR * noise and core.sum() > _WITHIN * light[light > _MAD * noise].sum()
    return (int(x), int(y)) if alone else None


def _moves(points: Sequence[tuple[int, int] | None]) -> bool:
    """Whether most points are there, and are no pixel that is always bright."""
    found = [point for point in points if point is not None]
    return 2 * len(found) > len(points) and bool(np.ptp(np.array(found), axis=0).max() > 1)


def _extent(xy: NDArray[np.float64]) -> str:
    """From where to where something was followed."""
    with warnings.catch_warnings():
        # of a coordinate that is lost in all frames there is none
        warnings.simplefilter("ignore")
        low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    return " and ".join(f"{name} {a:.4g} to {b:.4g} px" for name, a, b in zip("xy", low, high, strict=True))


def looks_dark(image: Image) -> bool:
    """Whether the object in a picture is darker than its ground."""
    low, middle, high = np.percentile(image, [0.1, 50.0, 99.9])
    return bool(middle - low > _DARK * (high - middle))


def _sensor(full_scale_dn: int, noise_dn: int = 1, *, dark: bool) -> SensorModel:
    """Black becomes full scale in an inverted picture, but is as good a level as any: nothing is cut off."""
    gain = _WELL_E / full_scale_dn
    return SensorModel(gain, gain * noise_dn, 2.0 * full_scale_dn if dark else full_scale_dn)


def inverted(image: Image, full_scale_dn: int) -> Image:
    """Dark becomes bright; what is above full scale is black."""
    turned: NDArray[np.int64] = full_scale_dn - np.minimum(image, full_scale_dn).astype(np.int64)
    return np.asarray(turned.astype(image.dtype))


def _torn(since_s: NDArray[np.float64], places: NDArray[np.float64]) -> list[str]:
    """A line on positions that tear off: a decoder takes some damage of a compressed film for good data."""
    torn = torn_positions(since_s, places)
    if not torn:
        return []
    at = ", ".join(f"{since_s[one]:.3f} s" for one in torn[:_PLACES])
    more = f" and {len(torn) - _PLACES} more" if len(torn) > _PLACES else ""
    what = "damage that the decoder took for good data, strong compression, or a push"
    return [f"positions break away at {at}{more}: {what}; --from and --to leave it out"]


def _flagged(flags: Counter[str], count: int) -> str:
    """What else was noticed of a good part of the frames."""
    doubts = [
        f"{name.lower().replace('_', ' ')} in {100 * flags[name] / count:.0f} %"
        for name in ("SATURATED", _WHITE, "EDGE", "CUT", "POOR_FIT", "MULTIPLE")
        if flags[name] > 0.05 * count
    ]
    return f"; {', '.join(doubts)}" if doubts else ""


def _pixel(text: str) -> tuple[float, str]:
    """Size of a pixel and its unit: stated, or a length over the number of pixels that it takes."""
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


def _inside(path: Path, since_s: NDArray[np.float64], asked: FilmAsked) -> NDArray[np.bool_]:
    begin_s = 0.0 if asked.begin_s is None else asked.begin_s
    end_s = float(since_s[-1]) if asked.end_s is None else asked.end_s
    inside = (since_s >= begin_s) & (since_s <= end_s)
    if len(since_s) < 2:
        raise DataError(f"{path}: one frame of it can be read; a film of ten periods or more is needed")
    if np.count_nonzero(inside) < 2:
        raise ConfigurationError(
            f"--from {begin_s:g} --to {end_s:g} leaves no frames of 0 to {since_s[-1]:.6g} s"
        )
    return np.asarray(inside)


def torn_positions(time_s: Floats, positions: Floats) -> list[int]:
    """First indices of stretches at which one of the coordinates (n, m), in px, tears off.

    Each position is foretold by a cubic through three neighbours on each side. How far off that usually is
    (noise, and what a cubic lacks of a swing) is told by a hundred on each side. Where a neighbour
    is lost nothing is said.
    """
    count = len(time_s)
    if count < 4 * _BESIDE:
        return []
    middle = np.arange(_BESIDE, count - _BESIDE)
    beside = middle[:, None] + np.array([k for k in range(-_BESIDE, _BESIDE + 1) if k])
    since = time_s[beside] - time_s[middle][:, None]
    since /= np.abs(since).max(axis=1, keepdims=True)
    weights = np.linalg.pinv(since[:, :, None] ** np.arange(4))[:, 0, :]
    torn = np.zeros(count, dtype=bool)
    for column in positions.T:
        off = np.abs(column[middle] - np.sum(weights * column[beside], axis=1))
        padded = np.pad(off, _AROUND, constant_values=np.nan)
        around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1)
        known = np.isfinite(off)
        if not known.any():
            continue
        usual = np.full(len(off), np.nan)
        usual[known] = np.nanquantile(around[known], _USUAL, axis=1)
        with np.errstate(invalid="ignore"):
            torn[middle] |= off > np.maximum(_TORN * usual, _LEAST_PX)
    places = np.flatnonzero(torn)
    # one tear is felt by its neighbours' forecasts
    return [int(one) for k, one in enumerate(places) if k == 0 or one > places[k - 1] + 2 * _BESIDE]
