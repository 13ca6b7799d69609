"""Whole spots of a record; the calibrations of axes and pointing from them, and of the sensor from frames."""

import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from calibration import Sign, Stability, fit_axes, photon_transfer, require_rest, stability
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import ConfigurationError, DataError
from processing.spot import SpotFlag
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.calibrate.inputs import frames_of, read_transfer
from rig.instrument import recorded_configuration

_SEGMENTS = 16  # the scatter of so many means is known to 18 %
_SATURATED = 0.1
"""Largest fraction of saturated spots, which are left out; above it the record is rejected."""


def mean_spot(spots: Deflections) -> tuple[float, float, float, float]:
    """Mean x and y in px, then their standard uncertainties.

    The uncertainties are the larger of those stated by the tracker and those from the scatter of the
    means of segments, which includes a slow drift.
    """
    found = []
    for values, u in ((spots.x, spots.u_x), (spots.y, spots.u_y)):
        means = np.array([part.mean() for part in np.array_split(values, _SEGMENTS)])
        claimed = float(np.sqrt(np.mean(u**2) / len(u)))
        found.append((float(values.mean()), max(float(means.std(ddof=1)) / math.sqrt(_SEGMENTS), claimed)))
    return found[0][0], found[1][0], found[0][1], found[1][1]


def spots_of_record(record: Path) -> tuple[Deflections, datetime.datetime]:
    """Positions of a record's complete, unsaturated spots on the sensor, and the start of the record.

    x and y are in px from the sensor's first pixel, y downward. Raises DataError as `whole_spots`.
    """
    good, began = whole_spots(record)
    x_px, y_px, u_x_px, u_y_px = (good[name].copy() for name in ("x_px", "y_px", "u_x_px", "u_y_px"))
    return Deflections(good["time_ns"].copy(), x_px, y_px, u_x_px, u_y_px, DeflectionUnit.PX), began


def binning_of_record(record: Path) -> int:
    """The camera's binning in a record, twice as many pixels with a colour plane; 1 if it has none."""
    with RecordReader(record) as reader:
        stated = reader.metadata.get("camera_settings", {})
    binning = stated.get("binning", "")
    return (int(binning) if binning.isdecimal() else 1) * (2 if "colour_plane" in stated else 1)


def whole_spots(record: Path) -> tuple[NDArray[Any], datetime.datetime]:
    """The table of a record's complete, unsaturated spots, and the start of the record.

    Raises DataError if there are fewer than 100 such spots, or if more than a tenth of all is saturated.
    """
    with RecordReader(record) as reader:
        table = reader.spots()
        began = reader.utc(int(table["time_ns"][0]) if len(table) else 0)
    bad = SpotFlag.LOST | SpotFlag.SATURATED | SpotFlag.EDGE | SpotFlag.CUT
    good = table[(table["flags"].astype(np.int64) & int(bad)) == 0] if len(table) else table
    saturated = 0.0
    if len(table):
        saturated = float(np.mean((table["flags"].astype(np.int64) & int(SpotFlag.SATURATED)) != 0))
    if saturated > _SATURATED:
        raise DataError(f"{record}: {100 * saturated:.0f} % of the spots are saturated; use less light")
    if len(good) < 100:
        raise DataError(
            f"{record}: {len(good)} of {len(table)} frames have a whole, unsaturated spot; "
            "at least 100 are needed"
        )
    return good, began


def calibrate_axes(record: Path, filing: Filing, slow_began: Sign | None, fast_began: Sign | None) -> Path:
    """Directions of both modes from a record in which both swing."""
    spots, began = spots_of_record(record)
    with RecordReader(record) as reader:
        before = recorded_configuration(reader).axes
    fit = fit_axes(
        spots.times_s,
        spots.x,
        spots.y,
        slow_began=slow_began,
        fast_began=fast_began,
        mirrored=before.mirrored if before is not None else False,
    )
    details = details_of(fit, "axes", "notes")
    return file_calibration(
        "axes", filing, "both modes fitted", fit.axes.model_dump(), details, [record], fit.notes, began
    )


def calibrate_sensor(frames: Path, filing: Filing) -> Path:
    """Photon transfer from pairs of dark and of uniformly lit frames: see `read_transfer`."""
    table = read_transfer(frames)
    place = frames.parent
    named = {"darks": table.darks, **{f"level.{n}.frames": item.frames for n, item in enumerate(table.level)}}
    missing = [f"{key} = '{name}'" for key, name in named.items() if not (place / name).exists()]
    if missing:
        raise ConfigurationError(
            f"{frames}: {', '.join(missing)}: no such record, folder or file of frames in {place.resolve()}, "
            "where this list lies"
        )
    darks, full_scale = frames_of(place / table.darks)
    pairs, sources = [], [frames, place / table.darks]
    for level in table.level:
        images, scale = frames_of(place / level.frames)
        if len(images) < 2:
            raise DataError(f"{level.frames}: holds {len(images)} frame; a pair is needed at each level")
        if scale != full_scale or images[0].shape != darks[0].shape:
            raise DataError(f"{level.frames}: frames of another shape or depth than those in {table.darks}")
        pairs.append((images[0], images[1]))
        sources.append(place / level.frames)
    exposures = [level.exposure_us for level in table.level if level.exposure_us is not None]
    found = photon_transfer(
        pairs,
        darks,
        table.full_scale_dn or full_scale,
        names=[str(level.frames) for level in table.level],
        exposures_us=exposures if len(exposures) == len(pairs) else [],
    )
    values = {
        "gain_e_per_dn": found.gain_e_per_dn,
        "read_noise_e": found.read_noise_e,
        "full_scale_dn": float(table.full_scale_dn or full_scale),
        "pedestal_dn": found.dark_level_dn,
        # an insignificant spread would only make the tracker's weights worse
        "prnu": found.prnu if found.prnu > 2.0 * found.u_prnu else 0.0,
    }
    details = details_of(
        found, "gain_e_per_dn", "read_noise_e", "dark_level_dn", "points", "hot_pixels", "rejected"
    )
    details["signal_dn"] = [point.signal_dn for point in found.points]
    details["variance_dn2"] = [point.variance_dn2 for point in found.points]
    details["u_variance_dn2"] = [point.u_variance_dn2 for point in found.points]
    details["hot_pixels_xy"] = found.hot_pixels.tolist()
    return file_calibration(
        "sensor", filing, "photon transfer (EMVA 1288)", values, details, sources, found.rejected
    )


def calibrate_pointing(record: Path, filing: Filing) -> Path:
    """Noise, drift and spectral lines of a spot that should be at rest."""
    spots, began = spots_of_record(record)
    require_rest(spots.times_s, spots.x, spots.y, str(record))
    details: dict[str, Any] = {}
    notes = []
    for name, values, u in (("x", spots.x, spots.u_x), ("y", spots.y, spots.u_y)):
        found = stability(spots.times_s, values, u)
        details[name] = _stability_details(found)
        notes += [
            f"{name}: {line.amplitude:.3g} px at {line.frequency_hz:.4g} Hz {line.name}".rstrip()
            for line in found.lines[:3]
        ]
        if not 0.7 < found.claimed_ratio < 1.4:
            notes.append(
                f"{name}: the tracker's uncertainty is {found.claimed_ratio:.2f} of the actual noise"
            )
    return file_calibration("pointing", filing, "pendulum at rest", {}, details, [record], notes, began)


def _stability_details(found: Stability) -> dict[str, Any]:
    details = details_of(found, "claimed_ratio", "allan", "lines", "frequency_hz", "density")
    return {
        **{f"{name}_px": value for name, value in details.items()},
        "claimed_ratio": found.claimed_ratio,
        "allan_tau_s": found.allan.tau_s.tolist(),
        "allan_px": found.allan.deviation.tolist(),
        "u_allan_px": found.allan.u_deviation.tolist(),
        "lines": [
            {"frequency_hz": line.frequency_hz, "amplitude_px": line.amplitude, "name": line.name}
            for line in found.lines
        ],
    }
