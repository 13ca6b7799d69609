"""`rig calibrate axes`, `sensor`, `pointing`, `clock` and `shutter`: from records and frames."""

import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import ShutterKind
from acquisition.record.digest import RecordedCamera
from acquisition.record.reader import RecordReader
from calibration import (
    FRAME_JITTER_LIMIT_S,
    ClockRelation,
    Sign,
    Stability,
    fit_axes,
    fit_row_time,
    photon_transfer,
    relate_clocks,
    require_rest,
    stability,
    unwrap_counter,
)
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import ConfigurationError, DataError
from processing.spot import SpotFlag
from processing.units import seconds
from rig.instrument import U_QUARTZ, recorded_configuration, u_of_host_rate
from rig.prepare.calibration_inputs import (
    Filing,
    TransferFile,
    details_of,
    file_calibration,
    frames_of,
    read_input,
)
from rig.terminal import percent

_SEGMENTS = 16  # the scatter of so many means is known to 18 %
_MAX_SATURATED_FRACTION = 0.1
"""Largest fraction of saturated spots (which are left out) before the record is rejected."""


def mean_spot(spots: Deflections) -> tuple[float, float, float, float]:
    """Mean x and y in px, and their standard uncertainties.

    Each uncertainty is the larger of the tracker's and that from the scatter of segment means, including slow
    drift.
    """
    found = []
    for values, u in ((spots.x, spots.u_x), (spots.y, spots.u_y)):
        means = np.array([part.mean() for part in np.array_split(values, _SEGMENTS)])
        claimed = float(np.sqrt(np.mean(u**2) / len(u)))
        found.append((float(values.mean()), max(float(means.std(ddof=1)) / math.sqrt(_SEGMENTS), claimed)))
    return found[0][0], found[1][0], found[0][1], found[1][1]


def spots_of_record(record: Path) -> tuple[Deflections, datetime.datetime]:
    """Positions of a record's complete, unsaturated spots on the sensor, and the start of the record.

    x and y are in px from the sensor's first pixel, y downward. Raises DataError like `whole_spots`.
    """
    good, began = whole_spots(record)
    x_px, y_px, u_x_px, u_y_px = (good[name].copy() for name in ("x_px", "y_px", "u_x_px", "u_y_px"))
    return Deflections(good["time_ns"].copy(), x_px, y_px, u_x_px, u_y_px, DeflectionUnit.PX), began


def binning_of_record(record: Path) -> int:
    """The camera's binning in a record, doubled for a colour plane; 1 if it states none."""
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
    if saturated > _MAX_SATURATED_FRACTION:
        raise DataError(f"{record}: {100 * saturated:.0f} % of the spots are saturated; use less light")
    if len(good) < 100:
        raise DataError(
            f"{record}: {len(good)} of {len(table)} frames have a whole, unsaturated spot; "
            "at least 100 are needed"
        )
    return good, began


def calibrate_axes(record: Path, filing: Filing, slow_began: Sign | None, fast_began: Sign | None) -> Path:
    """Calibrate the directions of both modes from a record in which both swing; returns the file."""
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


_MAX_LINEARITY_ERROR = 0.05
"""Departure of the light from the exposures above which a note is given; sensors depart by a per cent."""


def calibrate_sensor(frames: Path, filing: Filing) -> Path:
    """Calibrate the sensor by photon transfer from dark and uniformly lit frames; returns the file."""
    table = read_input(frames, TransferFile)
    place = frames.parent
    levels = {f"level {n}: frames": item.frames for n, item in enumerate(table.level, 1)}
    named = {"darks": table.darks, **levels}
    missing = [f"{key} = '{name}'" for key, name in named.items() if not (place / name).exists()]
    if missing:
        raise ConfigurationError(
            f"{frames}: {', '.join(missing)}: no such record, folder or file of frames in {place.resolve()}, "
            "where this list lies"
        )
    darks, full_scale = frames_of(place / table.darks)
    if table.full_scale_dn is not None and table.full_scale_dn > full_scale:
        raise ConfigurationError(
            f"{frames}: full_scale_dn = {table.full_scale_dn}: the frames in {table.darks} end at "
            f"{full_scale} DN; state the sensor's own, or leave it out"
        )
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
        # an insignificant value would only make the tracker's weights worse
        "prnu": found.prnu if found.prnu > 2.0 * found.u_prnu else 0.0,
    }
    details = details_of(
        found, "gain_e_per_dn", "read_noise_e", "dark_level_dn", "points", "hot_pixels", "rejected"
    )
    details["signal_dn"] = [point.signal_dn for point in found.points]
    details["variance_dn2"] = [point.variance_dn2 for point in found.points]
    details["u_variance_dn2"] = [point.u_variance_dn2 for point in found.points]
    details["hot_pixels_xy"] = found.hot_pixels.tolist()
    notes = list(found.rejected)
    if found.linearity_error > _MAX_LINEARITY_ERROR:
        notes.append(
            f"the light departs from exposure_us by {percent(found.linearity_error)}: see which level has "
            "which exposure, and whether the lamp is steady"
        )
    return file_calibration("sensor", filing, "photon transfer (EMVA 1288)", values, details, sources, notes)


def calibrate_pointing(record: Path, filing: Filing) -> Path:
    """Measure noise, drift and spectral lines of a spot at rest; returns the calibration file."""
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
    details = details_of(found, "claimed_ratio", "lines")
    return {
        **{f"{name}_px": value for name, value in details.items()},
        "claimed_ratio": found.claimed_ratio,
        "lines": [
            {"frequency_hz": line.frequency_hz, "amplitude_px": line.amplitude, "name": line.name}
            for line in found.lines
        ],
    }


def calibrate_clock(record: Path, filing: Filing, counter_bits: int | None) -> Path:
    """Calibrate the camera's clock against the host's monotonic clock; returns the file."""
    with RecordReader(record) as reader:
        config = recorded_configuration(reader)
        if config.simulated and config.on_demand:
            raise DataError(
                f"{record}: its frames were made on demand; simulation.real_time = true paces them"
            )
        if RecordedCamera.from_metadata(reader.metadata).has_clock is False:
            raise DataError(f"{record}: its camera has no clock of its own to compare")
        table = reader.spots()
        began = reader.utc(int(table["time_ns"][0]) if len(table) else 0)
        u_host_rate, synchronised = u_of_host_rate(reader)
    device = table["device_time_ns"].astype(np.int64)
    if counter_bits is not None:
        device = unwrap_counter(device, counter_bits)
    relation = relate_clocks(
        device, table["host_time_ns"].astype(np.int64), table["sequence"].astype(np.int64)
    )
    notes = [f"clock jump of {jump.step_s:.3g} s at frame {jump.frame}" for jump in relation.jumps]
    if relation.frame_jitter_s > FRAME_JITTER_LIMIT_S:
        notes.append(
            f"frame times jitter by {relation.frame_jitter_s * 1e6:.3g} µs, swings need "
            f"{FRAME_JITTER_LIMIT_S * 1e6:g} µs"
        )
    if not synchronised:
        notes.append("the host's clock was not known to be synchronised with UTC")
    values = {
        "camera_rate": relation.rate,
        "u_camera_rate": u_camera_rate(relation, u_host_rate),
    }
    details = {
        "drift_ppm": relation.drift_ppm,
        "u_drift_ppm": relation.u_drift_ppm,
        **details_of(relation, "rate", "u_rate", "device_reference_ns", "host_reference_ns"),
    }
    details["frame_jitter_limit_s"] = FRAME_JITTER_LIMIT_S
    details["host_synchronised"] = synchronised
    return file_calibration(
        "clock", filing, "camera against host, robust line", values, details, [record], notes, began
    )


def u_camera_rate(relation: ClockRelation, u_host_rate: float) -> float:
    """Relative standard uncertainty of the camera's rate at times other than the record's."""
    return math.hypot(relation.u_rate, u_host_rate, U_QUARTZ)


_MIN_ROW_TIME_S = 0.5e-6
"""Shortest row time: sensors with a rolling shutter need a microsecond or more for a row."""
_MIN_SIGNIFICANCE_U = 4.0
"""Row time in standard uncertainties that shows a rolling shutter: by noise, one run in 16,000 exceeds it."""


def calibrate_shutter(record: Path, filing: Filing) -> Path:
    """Calibrate row time and first row from a run in which the spot swings across the rows.

    Raises DataError for a run with a pulsed laser, which all rows see at the same time.
    """
    spots, began = whole_spots(record)
    # the times of frames, without the correction for a shutter in the record
    has_clock = spots["device_time_ns"] >= 0
    frame_times_ns = np.where(has_clock, spots["device_time_ns"], spots["host_time_ns"])
    times_s, y_px = seconds(frame_times_ns - frame_times_ns[0]), spots["y_px"].astype(np.float64)
    with RecordReader(record) as reader:
        config = recorded_configuration(reader)
        is_global = RecordedCamera.from_metadata(reader.metadata).shutter is ShutterKind.GLOBAL
    if config.laser.pulse_us:
        raise DataError(
            f"{record}: its laser was pulsed, so that all rows saw the light at the same time; measure the "
            "row time in a run without laser.pulse_us"
        )
    found = fit_row_time(times_s, y_px)
    row_time_s = abs(found.row_time_s)
    # the camera's report of a global shutter is believed only if the swing nearly confirms it
    is_global = is_global and row_time_s < _MIN_ROW_TIME_S
    rolls = row_time_s > _MIN_SIGNIFICANCE_U * found.u_row_time_s and not is_global
    if rolls:
        unequal = (
            f"half-periods differed by {4e3 * abs(found.row_time_s) * found.amplitude_px:.3g} ms at "
            f"{found.amplitude_px:.4g} px; with the slow axis along the rows they would not"
        )
        notes = [unequal]
    elif is_global:
        notes = ["the camera reports a global shutter: the fitted value is not a row time"]
    else:
        notes = ["all rows are exposed at once, as far as this run can tell (a global shutter)"]
    values = {
        "row_time_s": abs(found.row_time_s) if rolls else 0.0,
        "u_row_time_s": found.u_row_time_s,
        "first_row": "bottom" if rolls and found.row_time_s < 0 else "top",
    }
    if found.u_row_time_s > 0.03 * abs(found.row_time_s) and rolls:
        notes.append("uncertain by more than 3 %: a longer run with a larger swing would be better")
    return file_calibration(
        "shutter",
        filing,
        "second harmonic of a swing across the rows",
        values,
        {"fitted_row_time_s": found.row_time_s, **details_of(found, "row_time_s", "u_row_time_s")},
        [record],
        notes,
        began,
    )
