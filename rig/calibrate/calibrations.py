"""`rig calibrate`: records and tables in, a calibration file out; none is written where none can be had."""

import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from calibration.at_rest import require_rest
from calibration.axes_fit import Sign, fit_axes
from calibration.known_angle import check_scale
from calibration.lever import Lever
from calibration.lever_fit import LadderFit, fit_ladder, lever_from_shifts, lever_from_tilts
from calibration.lever_geometry import lever_from_geometry
from calibration.sensor import photon_transfer
from calibration.stability import Stability, stability
from calibration.store import read_calibration
from calibration.timebase import FRAME_JITTER_LIMIT_S, relate_clocks, unwrap_counter
from processing.errors import ConfigurationError, DataError
from rig.calibrate.filing import Filing, file_calibration
from rig.calibrate.inputs import LadderFile, frames_of, read_ladder, read_transfer
from rig.calibrate.spots import mean_spot, spots_of_record
from rig.devices import ntp_state
from rig.instrument import recorded_configuration

Floats = NDArray[np.float64]


def calibrate_lever(ladder: Path, filing: Filing) -> Path:
    """Lever from its geometry, or from a ladder of tilts or shifts: see `read_ladder`."""
    table = read_ladder(ladder)
    if table.geometry is not None:
        found = lever_from_geometry(table.geometry)
        details: dict[str, Any] = {
            "u_skew": found.u_skew,
            "u_scale_relative": found.lever.u_scale_relative,
            "cross": found.cross,
            "budget": [
                {
                    "name": line.name,
                    "value": line.value,
                    "u": line.u,
                    "effect": line.effect,
                    "u_part": line.contribution,
                }
                for line in found.budget
            ],
        }
        return file_calibration(
            "lever", filing, "geometry, traced", _plain_lever(found.lever), details, [ladder]
        )
    fit, sources, began = _climb(ladder, table)
    if table.kind == "tilt":
        lever = lever_from_tilts(fit, table.needed("pixel_pitch_m"))
    else:
        lever = lever_from_shifts(fit, table.needed("arm_m"), table.u_arm_m)
    details = {**_ladder_details(fit, table), "u_scale_relative": lever.u_scale_relative}
    method = f"ladder of {len(table.step)} {table.kind}s"
    return file_calibration("lever", filing, method, _plain_lever(lever), details, sources, fit.notes, began)


def check_known_angle(ladder: Path, lever: Path, filing: Filing) -> Path:
    """Known tilts against a lever in use."""
    table = read_ladder(ladder)
    if table.kind != "tilt" or table.geometry is not None:
        raise ConfigurationError(f"{ladder}: known tilts are needed for a check (kind = 'tilt')")
    in_use = Lever.model_validate(read_calibration(lever, "lever").values)
    fit, sources, began = _climb(ladder, table)
    check = check_scale(in_use, fit)
    details = {
        "ratio": check.ratio,
        "u_ratio": check.u_ratio,
        "u_both": check.u_both,
        "moved": check.moved,
        **_ladder_details(fit, table),
    }
    notes = list(fit.notes)
    if check.moved:
        notes.append(
            f"scale off by {100 * (check.ratio - 1):+.3g} %, u = {100 * check.u_both:.2g} %: calibrate again"
        )
    method = f"{len(table.step)} known tilts against {lever.name}"
    return file_calibration("check", filing, method, {}, details, [*sources, lever], notes, began)


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
    names = (
        *(
            "slow_period_s",
            "fast_period_s",
            "slow_px",
            "fast_px",
            "rotation_rad_per_s",
            "u_rotation_rad_per_s",
        ),
        *("windows", "chi2_per_dof", "signs_known", "handedness_known"),
    )
    details = {name: getattr(fit, name) for name in names}
    return file_calibration(
        "axes", filing, "both modes fitted", fit.axes.model_dump(), details, [record], fit.notes, began
    )


def calibrate_sensor(frames: Path, filing: Filing) -> Path:
    """Photon transfer from pairs of evenly lit frames and dark ones: see `read_transfer`."""
    table = read_transfer(frames)
    place = frames.parent
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
        # a spread that is not seen for sure would only blunt the tracker's weights
        "prnu": found.prnu if found.prnu > 2.0 * found.u_prnu else 0.0,
    }
    names = (
        *("u_gain_e_per_dn", "u_read_noise_e", "u_dark_level_dn", "read_noise_resolved", "full_well_e"),
        *("saturates", "linearity_error", "prnu", "u_prnu", "chi2_per_dof"),
    )
    details: dict[str, Any] = {name: getattr(found, name) for name in names}
    details["signal_dn"] = [point.signal_dn for point in found.points]
    details["variance_dn2"] = [point.variance_dn2 for point in found.points]
    details["u_variance_dn2"] = [point.u_variance_dn2 for point in found.points]
    details["hot_pixels_xy"] = found.hot_pixels.tolist()
    return file_calibration(
        "sensor", filing, "photon transfer (EMVA 1288)", values, details, sources, found.rejected
    )


def calibrate_clock(record: Path, filing: Filing, counter_bits: int | None) -> Path:
    """Camera clock against the host's monotonic clock."""
    with RecordReader(record) as reader:
        config = recorded_configuration(reader)
        if config.simulated and config.on_demand:
            raise DataError(
                f"{record}: its frames were made on demand; simulation.real_time = true paces them"
            )
        if reader.metadata.get("camera", {}).get("has_clock") == "False":
            raise DataError(f"{record}: its camera has no clock of its own; there is nothing to relate")
        table = reader.spots()
        began = reader.utc(int(table["time_ns"][0]) if len(table) else 0)
    device = table["device_time_ns"].astype(np.int64)
    if counter_bits is not None:
        device = unwrap_counter(device, counter_bits)
    relation = relate_clocks(
        device, table["host_time_ns"].astype(np.int64), table["sequence"].astype(np.int64)
    )
    ntp = ntp_state()
    notes = [f"clock jump of {jump.step_s:.3g} s at frame {jump.frame}" for jump in relation.jumps]
    if relation.frame_jitter_s > FRAME_JITTER_LIMIT_S:
        notes.append(
            f"frame times jitter by {relation.frame_jitter_s * 1e6:.3g} us, swings need "
            f"{FRAME_JITTER_LIMIT_S * 1e6:g} us"
        )
    if not ntp.synchronised:
        notes.append(f"the host's clock is not known to be synchronised with UTC ({ntp.text})")
    values = {
        "camera_rate": relation.rate,
        "u_camera_rate": math.hypot(relation.u_rate, ntp.u_rate),
    }
    names = (
        "drift_ppm",
        "u_drift_ppm",
        "jitter_s",
        "u_offset_s",
        "frame_period_s",
        "frame_jitter_s",
        "frames",
    )
    details: dict[str, Any] = {name: getattr(relation, name) for name in names}
    details["frame_jitter_limit_s"] = FRAME_JITTER_LIMIT_S
    details["jumps"] = [{"frame": jump.frame, "step_s": jump.step_s} for jump in relation.jumps]
    details["ntp"] = ntp.text
    details["ntp_synchronised"] = ntp.synchronised
    return file_calibration(
        "clock", filing, "camera against host, robust line", values, details, [record], notes, began
    )


def calibrate_pointing(record: Path, filing: Filing) -> Path:
    """Noise, drift and lines of a spot that should stand still."""
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
            notes.append(f"{name}: the tracker claims {found.claimed_ratio:.2f} of the noise that is there")
    return file_calibration("pointing", filing, "pendulum at rest", {}, details, [record], notes, began)


def _climb(path: Path, table: LadderFile) -> tuple[LadderFit, list[Path], datetime.datetime | None]:
    """The ladder's fit, the files that it rests on, and when it was climbed."""
    sources, began = [path], None
    rows = []
    for number, step in enumerate(table.step, 1):
        if step.record is None:
            rows.append((step.x_px, step.y_px, step.u_px, step.u_px))
            continue
        record = path.parent / step.record
        spots, step_began = spots_of_record(record)
        require_rest(spots.times_s, spots.x, spots.y, f"step {number}, {record}")
        sources.append(record)
        began = step_began if began is None else max(began, step_began)
        rows.append(mean_spot(spots))
    return (
        fit_ladder(table.steps(rows), table.kind, u_reference_relative=table.u_reference_relative),
        sources,
        began,
    )


def _ladder_details(fit: LadderFit, table: LadderFile) -> dict[str, Any]:
    names = (
        *("scale", "u_scale", "direction_rad", "u_direction_rad", "skew", "u_skew", "nonlinear"),
        *("nonlinear_probability", "hysteresis", "u_hysteresis", "chi2", "dof"),
    )
    return {
        "reference": [table.in_si(step.reference) for step in table.step],
        "residual_px": fit.residual_px.tolist(),
        "leave_one_out": fit.leave_one_out.tolist(),
        "u_reference_relative": table.u_reference_relative,
        **{name: getattr(fit, name) for name in names},
    }


def _stability_details(found: Stability) -> dict[str, Any]:
    names = ("noise", "drift_per_s", "u_drift_per_s", "iso11670", "claimed_ratio")
    return {
        **{f"{name}_px": getattr(found, name) for name in names[:-1]},
        "claimed_ratio": found.claimed_ratio,
        "allan_tau_s": found.allan.tau_s.tolist(),
        "allan_px": found.allan.deviation.tolist(),
        "u_allan_px": found.allan.u_deviation.tolist(),
        "lines": [
            {"frequency_hz": line.frequency_hz, "amplitude_px": line.amplitude, "name": line.name}
            for line in found.lines
        ],
    }


def _plain_lever(lever: Lever) -> dict[str, Any]:
    return lever.model_dump(exclude_none=True)
