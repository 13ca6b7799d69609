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

_SEGMENTS = 16
"""Number of means whose scatter gives an uncertainty; the scatter of 16 means is known to 18 %."""
_MIN_SPOTS = 100
_MAX_SATURATED_FRACTION = 0.1
"""Largest fraction of saturated spots (which are left out) before the record is rejected."""


def mean_spot(spots: Deflections) -> tuple[float, float, float, float]:
    """Mean x and y in px, and their standard uncertainties.

    Each uncertainty is the larger of the tracker's and that from the scatter of the means of segments, which
    includes slow drift.
    """
    means, uncertainties = [], []
    for values, u in ((spots.x, spots.u_x), (spots.y, spots.u_y)):
        segment_means = np.array([segment.mean() for segment in np.array_split(values, _SEGMENTS)])
        u_of_scatter = float(segment_means.std(ddof=1)) / math.sqrt(_SEGMENTS)
        means.append(float(values.mean()))
        uncertainties.append(max(u_of_scatter, float(np.sqrt(np.mean(u**2) / len(u)))))
    return means[0], means[1], uncertainties[0], uncertainties[1]


def spots_of_record(record: Path) -> tuple[Deflections, datetime.datetime]:
    """Positions of a record's complete, unsaturated spots on the sensor, and the start of the record.

    x and y are in px from the sensor's first pixel, y downward. Raises DataError like `_sound_spots`.
    """
    table, began = _sound_spots(record)
    x_px, y_px, u_x_px, u_y_px = (table[name].copy() for name in ("x_px", "y_px", "u_x_px", "u_y_px"))
    return Deflections(table["time_ns"].copy(), x_px, y_px, u_x_px, u_y_px, DeflectionUnit.PX), began


def binning_of_record(record: Path) -> int:
    """The camera's binning in a record, doubled for a colour plane; 1 if it states none."""
    with RecordReader(record) as reader:
        settings = reader.metadata.get("camera_settings", {})
    binning = settings.get("binning", "")
    return (int(binning) if binning.isdecimal() else 1) * (2 if "colour_plane" in settings else 1)


def _sound_spots(record: Path) -> tuple[NDArray[Any], datetime.datetime]:
    """The complete, unsaturated spots of a record, and its start; raises DataError for too few of them."""
    with RecordReader(record) as reader:
        table = reader.spots()
        began = _start_utc(reader, table)
    flags = table["flags"].astype(np.int64)
    sound = table[flags & int(SpotFlag.LOST | SpotFlag.SATURATED | SpotFlag.EDGE | SpotFlag.CUT) == 0]
    saturated = np.count_nonzero(flags & int(SpotFlag.SATURATED)) / max(len(table), 1)
    if saturated > _MAX_SATURATED_FRACTION:
        raise DataError(f"{record}: {100 * saturated:.0f} % of the spots are saturated; use less light")
    if len(sound) < _MIN_SPOTS:
        raise DataError(
            f"{record}: {len(sound)} of {len(table)} frames have a whole, unsaturated spot; "
            f"at least {_MIN_SPOTS} are needed"
        )
    return sound, began


def _start_utc(reader: RecordReader, table: NDArray[Any]) -> datetime.datetime:
    """Time of the first spot, or of the record's time 0 without spots."""
    return reader.utc(int(table["time_ns"][0]) if len(table) else 0)


def calibrate_axes(record: Path, filing: Filing, slow_began: Sign | None, fast_began: Sign | None) -> Path:
    """Calibrate the directions of both modes from a record in which both swing; returns the file."""
    spots, began = spots_of_record(record)
    with RecordReader(record) as reader:
        axes = recorded_configuration(reader).axes
    fit = fit_axes(
        spots.times_s,
        spots.x,
        spots.y,
        slow_began=slow_began,
        fast_began=fast_began,
        mirrored=axes.mirrored if axes is not None else False,
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
    folder = frames.parent
    levels = {f"level {n}: frames": level.frames for n, level in enumerate(table.level, 1)}
    names = {"darks": table.darks, **levels}
    missing = [f"{key} = '{name}'" for key, name in names.items() if not (folder / name).exists()]
    if missing:
        raise ConfigurationError(
            f"{frames}: {', '.join(missing)}: no such record, folder or file of frames in "
            f"{folder.resolve()}, where this list lies"
        )
    darks, full_scale = frames_of(folder / table.darks)
    if table.full_scale_dn is not None and table.full_scale_dn > full_scale:
        raise ConfigurationError(
            f"{frames}: full_scale_dn = {table.full_scale_dn}: the frames in {table.darks} end at "
            f"{full_scale} DN; state the sensor's own, or leave it out"
        )
    pairs, sources = [], [frames, folder / table.darks]
    for level in table.level:
        images, scale = frames_of(folder / level.frames)
        if len(images) < 2:
            raise DataError(f"{level.frames}: holds {len(images)} frame; a pair is needed at each level")
        if scale != full_scale or images[0].shape != darks[0].shape:
            raise DataError(f"{level.frames}: frames of another shape or depth than those in {table.darks}")
        pairs.append((images[0], images[1]))
        sources.append(folder / level.frames)
    exposures = [level.exposure_us for level in table.level if level.exposure_us is not None]
    transfer = photon_transfer(
        pairs,
        darks,
        table.full_scale_dn or full_scale,
        names=[str(level.frames) for level in table.level],
        exposures_us=exposures if len(exposures) == len(pairs) else [],
    )
    values = {
        "gain_e_per_dn": transfer.gain_e_per_dn,
        "read_noise_e": transfer.read_noise_e,
        "full_scale_dn": float(table.full_scale_dn or full_scale),
        "pedestal_dn": transfer.dark_level_dn,
        # an insignificant value would only make the tracker's weights worse
        "prnu": transfer.prnu if transfer.prnu > 2.0 * transfer.u_prnu else 0.0,
    }
    details = details_of(
        transfer, "gain_e_per_dn", "read_noise_e", "dark_level_dn", "points", "hot_pixels", "rejected"
    )
    details["signal_dn"] = [point.signal_dn for point in transfer.points]
    details["variance_dn2"] = [point.variance_dn2 for point in transfer.points]
    details["u_variance_dn2"] = [point.u_variance_dn2 for point in transfer.points]
    details["hot_pixels_xy"] = transfer.hot_pixels.tolist()
    notes = list(transfer.rejected)
    if transfer.linearity_error > _MAX_LINEARITY_ERROR:
        notes.append(
            f"the light departs from exposure_us by {percent(transfer.linearity_error)}: see which level has "
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
        result = stability(spots.times_s, values, u)
        details[name] = _stability_details(result)
        notes += [
            f"{name}: {line.amplitude:.3g} px at {line.frequency_hz:.4g} Hz {line.name}".rstrip()
            for line in result.lines[:3]
        ]
        if not 0.7 < result.claimed_ratio < 1.4:
            notes.append(
                f"{name}: the tracker's uncertainty is {result.claimed_ratio:.2f} of the actual noise"
            )
    return file_calibration("pointing", filing, "pendulum at rest", {}, details, [record], notes, began)


def _stability_details(result: Stability) -> dict[str, Any]:
    details = details_of(result, "claimed_ratio", "lines")
    return {
        **{f"{name}_px": value for name, value in details.items()},
        "claimed_ratio": result.claimed_ratio,
        "lines": [
            {"frequency_hz": line.frequency_hz, "amplitude_px": line.amplitude, "name": line.name}
            for line in result.lines
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
        began = _start_utc(reader, table)
        u_host_rate, synchronised = u_of_host_rate(reader)
    camera_ns = table["device_time_ns"].astype(np.int64)
    if counter_bits is not None:
        camera_ns = unwrap_counter(camera_ns, counter_bits)
    relation = relate_clocks(
        camera_ns, table["host_time_ns"].astype(np.int64), table["sequence"].astype(np.int64)
    )
    notes = [f"clock jump of {jump.step_s:.3g} s at frame {jump.frame}" for jump in relation.jumps]
    if relation.frame_jitter_s > FRAME_JITTER_LIMIT_S:
        notes.append(
            f"frame times jitter by {relation.frame_jitter_s * 1e6:.3g} µs, swings need "
            f"{FRAME_JITTER_LIMIT_S * 1e6:g} µs"
        )
    if not synchronised:
        notes.append("the host's clock was not known to be synchronised with UTC")
    values = {"camera_rate": relation.rate, "u_camera_rate": u_camera_rate(relation, u_host_rate)}
    details = {
        "drift_ppm": relation.drift_ppm,
        "u_drift_ppm": relation.u_drift_ppm,
        **details_of(relation, "rate", "u_rate", "device_reference_ns", "host_reference_ns"),
        "frame_jitter_limit_s": FRAME_JITTER_LIMIT_S,
        "host_synchronised": synchronised,
    }
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
    spots, began = _sound_spots(record)
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
    fit = fit_row_time(times_s, y_px)
    row_time_s = abs(fit.row_time_s)
    # the camera's report of a global shutter is believed only if the swing nearly confirms it
    is_global = is_global and row_time_s < _MIN_ROW_TIME_S
    is_rolling = row_time_s > _MIN_SIGNIFICANCE_U * fit.u_row_time_s and not is_global
    if is_rolling:
        unequal = (
            f"half-periods differed by {4e3 * row_time_s * fit.amplitude_px:.3g} ms at "
            f"{fit.amplitude_px:.4g} px; with the slow axis along the rows they would not"
        )
        notes = [unequal]
    elif is_global:
        notes = ["the camera reports a global shutter: the fitted value is not a row time"]
    else:
        notes = ["all rows are exposed at once, as far as this run can tell (a global shutter)"]
    values = {
        "row_time_s": row_time_s if is_rolling else 0.0,
        "u_row_time_s": fit.u_row_time_s,
        "first_row": "bottom" if is_rolling and fit.row_time_s < 0 else "top",
    }
    if is_rolling and fit.u_row_time_s > 0.03 * row_time_s:
        notes.append("uncertain by more than 3 %: a longer run with a larger swing would be better")
    method = "second harmonic of a swing across the rows"
    details = {"fitted_row_time_s": fit.row_time_s, **details_of(fit, "row_time_s", "u_row_time_s")}
    return file_calibration("shutter", filing, method, values, details, [record], notes, began)
