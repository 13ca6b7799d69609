"""`rig calibrate clock`: the camera's clock against the host's."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from acquisition.record.recorded_camera import RecordedCamera
from calibration import FRAME_JITTER_LIMIT_S, ClockRelation, relate_clocks, unwrap_counter
from processing.errors import DataError
from processing.robust import robust_scatter
from processing.ticks import S_PER_NS, seconds
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.devices import U_QUARTZ, ntp_state
from rig.instrument import recorded_configuration

_PARTS = 24
_FEWEST_IN_PART = 10
_OF_MEDIAN = math.sqrt(math.pi / 2.0)
"""Standard uncertainty of a median over that of a mean, of normal deviates."""
_ROUNDING_S = S_PER_NS / math.sqrt(12.0)


def calibrate_clock(record: Path, filing: Filing, counter_bits: int | None) -> Path:
    """Camera clock against the host's monotonic clock."""
    with RecordReader(record) as reader:
        config = recorded_configuration(reader)
        if config.simulated and config.on_demand:
            raise DataError(
                f"{record}: its frames were made on demand; simulation.real_time = true paces them"
            )
        if RecordedCamera.of(reader.metadata).has_clock is False:
            raise DataError(f"{record}: its camera has no clock of its own to compare")
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
            f"frame times jitter by {relation.frame_jitter_s * 1e6:.3g} µs, swings need "
            f"{FRAME_JITTER_LIMIT_S * 1e6:g} µs"
        )
    if not ntp.synchronised:
        notes.append(f"the host's clock is not known to be synchronised with UTC ({ntp.text})")
    values = {
        "camera_rate": relation.rate,
        "u_camera_rate": u_camera_rate(relation, ntp.u_rate),
    }
    details = {
        "drift_ppm": relation.drift_ppm,
        "u_drift_ppm": relation.u_drift_ppm,
        **details_of(relation, "rate", "u_rate", "device_reference_ns", "host_reference_ns"),
        **off_line(relation, device, table["host_time_ns"].astype(np.int64), table["sequence"]),
    }
    details["frame_jitter_limit_s"] = FRAME_JITTER_LIMIT_S
    details["ntp"] = ntp.text
    details["ntp_synchronised"] = ntp.synchronised
    return file_calibration(
        "clock", filing, "camera against host, robust line", values, details, [record], notes, began
    )


def u_camera_rate(relation: ClockRelation, u_host_rate: float) -> float:
    """Relative standard uncertainty of the camera's rate at other times than the record's."""
    return math.hypot(relation.u_rate, u_host_rate, U_QUARTZ)


def off_line(
    relation: ClockRelation,
    device_ns: NDArray[np.int64],
    host_ns: NDArray[np.int64],
    sequence: NDArray[np.integer],
) -> dict[str, list[float]]:
    """Arrivals minus the line and its jumps: medians over equal parts of the record.

    Medians, because single frames arrive much later than the others.
    """
    off_s = seconds((host_ns - relation.host_ns(device_ns)).astype(np.float64))
    for jump in relation.jumps:
        off_s[sequence >= jump.frame] -= jump.step_s
    at_s = seconds(device_ns - device_ns[0])
    count = max(1, min(_PARTS, len(off_s) // _FEWEST_IN_PART))
    rows = []
    for at, off in zip(np.array_split(at_s, count), np.array_split(off_s, count), strict=True):
        u_s = _OF_MEDIAN * robust_scatter(off) / math.sqrt(len(off))
        rows.append((float(at.mean()), float(np.median(off)), max(u_s, _ROUNDING_S)))
    return dict(
        zip(("parts_at_s", "off_line_s", "u_off_line_s"), map(list, zip(*rows, strict=True)), strict=True)
    )
