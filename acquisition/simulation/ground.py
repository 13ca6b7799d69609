"""The ground under the simulated pendulum, and the angle by which it drives each mode.

The mass centre lies a height d over the point of contact. In a base that is accelerated by a(t) along
the swing and tilted by th(t), its inertia turns the pendulum about the point of contact, and gravity's
restoring moment is measured from the tilted base:

    I phi'' + m g R (phi - th) = M_fr + M_el - m d a

Divided by m g R, the ground adds the angle th - d a/(g R) to the rest position. Both modes roll on the same
ball under the same weight: they differ in I alone, I_U = I_V/`period_ratio`^2, and this angle drives each
with its own component of a and th. A tilt of laser and sensor with the base is neglected.
"""

import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.settings import ARCSEC_RAD, GroundTruth, SimulationSettings
from acquisition.simulation.smooth_series import (
    BLOCK_KNOTS,
    DEGREE,
    KNOTS_PER_PERIOD,
    BandNoise,
    SmoothSeries,
    Term,
    coefficients_through,
    sampled,
)
from processing.errors import ConfigurationError, one_line_text
from processing.noise_models import density_of_db, nhnm_db, nlnm_db
from processing.units import conversion

_MIN_SAMPLES = 64
_KEY = "simulation.ground.file"
_STEP_DURATION_S = 1.0


class GroundRecord(NamedTuple):
    """Accelerations at even times: (n, 1) or (n, 2) in m/s^2, without the mean of each column."""

    rate_hz: float
    accelerations_m_per_s2: NDArray[np.float64]


def read_ground_file(path: Path) -> GroundRecord:
    """Read a CSV file: a header, then time in s and one or two accelerations per line.

    The first column is `time_s`; the names of the others end in their unit, for example
    `acceleration_m_per_s2`. Raises ConfigurationError, in one line, for a missing unit, a value that is no
    number, and times that are not even (a gap).
    """
    try:
        with path.open(encoding="utf-8") as file:
            scales = _scales(path, file.readline().rstrip("\n"))
            rows = file.readlines()
        values = np.loadtxt(rows, delimiter=",", ndmin=2) if any(map(str.strip, rows)) else np.empty((0, 1))
    except FileNotFoundError:
        raise _fault(path, "no such file; name a CSV file of ground accelerations") from None
    except (OSError, ValueError) as error:
        raise _fault(path, f"cannot be read: {one_line_text(error)}; cut the file at its gaps") from None
    if len(values) < _MIN_SAMPLES:
        raise _fault(path, f"has {len(values)} samples; at least {_MIN_SAMPLES} are needed")
    if values.shape[1] != 1 + len(scales) or not np.isfinite(values).all():
        raise _fault(path, f"not all rows are {1 + len(scales)} finite numbers; cut the file at its gaps")
    steps_s = np.diff(values[:, 0])
    step_s = float(np.median(steps_s))
    uneven = np.flatnonzero(~(np.abs(steps_s - step_s) <= 0.01 * step_s))
    if step_s <= 0 or len(uneven):
        before_s, after_s = values[:2, 0] if step_s <= 0 else values[uneven[0] :, 0][:2]
        raise _fault(
            path,
            f"time_s goes from {before_s:.10g} to {after_s:.10g}, where {step_s:.6g} s is the step; "
            "cut the file at its gaps",
        )
    accelerations = values[:, 1:] * scales
    seconds = float(values[-1, 0] - values[0, 0])
    return GroundRecord((len(values) - 1) / seconds, accelerations - accelerations.mean(axis=0))


def _scales(path: Path, header: str) -> NDArray[np.float64]:
    """Factors that convert the columns of accelerations to m/s^2."""
    names = [name.strip() for name in header.split(",")]
    remedy = (
        "the header must read time_s,acceleration_m_per_s2 (or _um_per_s2, _nm_per_s2), with a second "
        "acceleration if there is one"
    )
    if names[0] != "time_s" or not 2 <= len(names) <= 3:
        raise _fault(path, f"its first line is {header[:60]!r}; {remedy}")
    scales = []
    for name in names[1:]:
        # a name ends in its unit: acceleration_um_per_s2
        numerator, _, denominator = name.rpartition("_per_")
        unit = f"{numerator.rpartition('_')[2]}/{denominator.replace('s2', 's^2')}"
        try:
            scales.append(conversion(unit, "m/s^2"))
        except ConfigurationError:
            raise _fault(path, f"column {name} has no unit of acceleration; {remedy}") from None
    return np.array(scales)


def _fault(path: Path, message: str) -> ConfigurationError:
    return ConfigurationError(f"{_KEY} = {str(path)!r}: {message}")


_ACCELERATION, _TILT, _SEISMOMETER = (12, 13), (14, 15), 17
"""Purposes of the random numbers; each purpose has numbers of its own."""
SLOW, FAST = 0, 1


class GroundMotion(NamedTuple):
    """Motion of the ground along the slow and the fast swing: acceleration, tilt, and driving angle."""

    acceleration_m_per_s2: tuple[SmoothSeries, SmoothSeries]
    tilt_rad: tuple[SmoothSeries, SmoothSeries]
    drive_rad: tuple[SmoothSeries, SmoothSeries]


def ground_of(settings: SimulationSettings, run: int) -> GroundMotion | None:
    """The ground of one run; None where it does not move.

    Raises ConfigurationError for a file that cannot be used, or is shorter than `max_duration_s`.
    """
    truth = settings.ground
    if truth.model == "none" and not truth.base_tilts:
        return None
    seed = (settings.seed + 0x9E3779B97F4A7C15 * truth.seed) % 2**63
    record = None
    rate_hz = KNOTS_PER_PERIOD * truth.bandwidth_hz
    end_s = math.inf
    if truth.model == "file":
        record = _knots_of_file(truth)
        rate_hz = record.rate_hz
        end_s = (len(record.accelerations_m_per_s2) - 1) / rate_hz - truth.file_offset_s
        _check_length(settings, end_s)
    contact = settings.contact
    lever = truth.mass_centre_height_m / (contact.gravity_m_per_s2 * contact.ball_radius_m)
    series = []
    for mode in (SLOW, FAST):
        shaking: list[tuple[float, Term]] = []
        tilting: list[tuple[float, Term]] = []
        if record is not None:
            if mode < record.accelerations_m_per_s2.shape[1]:
                shaking.append((1.0, _record_term(record, mode, truth.file_offset_s)))
        elif truth.model != "none":
            key = seed, run, _ACCELERATION[mode]
            density = functools.partial(acceleration_density, truth)
            shaking.append((1.0, BandNoise(density, rate_hz, truth.bandwidth_hz, key)))
        if truth.tilt_rad_per_sqrt_hz > 0:
            noise = BandNoise(np.ones_like, rate_hz, truth.bandwidth_hz, (seed, run, _TILT[mode]))
            tilting.append((truth.tilt_rad_per_sqrt_hz, noise))
        if tilt_rad := _base_tilt(truth, mode):
            tilting.append((1.0, sampled(tilt_rad, rate_hz)))
        driving = [*tilting, *((-lever * factor, term) for factor, term in shaking)]
        series.append([SmoothSeries(rate_hz, terms, end_s) for terms in (shaking, tilting, driving)])
    acceleration, tilt, drive = zip(*series, strict=True)
    return GroundMotion(acceleration, tilt, drive)


def acceleration_density(truth: GroundTruth, frequencies_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Amplitude spectral density of 'white' or 'peterson', one-sided, per component, in m/s^2/sqrt(Hz)."""
    if truth.model == "white":
        return np.full(len(frequencies_hz), truth.white_m_per_s2_per_sqrt_hz)
    low_db = nlnm_db(frequencies_hz)
    if truth.above_low_noise_db is not None:
        return density_of_db(low_db + truth.above_low_noise_db)
    return density_of_db(low_db + truth.between_noise_models * (nhnm_db(frequencies_hz) - low_db))


def _knots_of_file(truth: GroundTruth) -> GroundRecord:
    """The file's accelerations, resampled by a whole number to as few knots as `bandwidth_hz` needs."""
    assert truth.file is not None
    record = read_ground_file(truth.file)
    needed_hz = KNOTS_PER_PERIOD * truth.bandwidth_hz
    up = max(1, math.ceil(needed_hz / record.rate_hz - 1e-6))
    down = max(1, math.floor(record.rate_hz / needed_hz + 1e-6))
    values = record.accelerations_m_per_s2
    if up > 1 or down > 1:
        # imported here because it is the slowest import of all, and only this function needs it
        from scipy.signal import resample_poly

        values = resample_poly(values, up, down, axis=0, padtype="line")
    # knots beyond the last sample would be extrapolated
    count = 1 + (len(record.accelerations_m_per_s2) - 1) * up // down
    return GroundRecord(record.rate_hz * up / down, values[:count])


def _record_term(record: GroundRecord, column: int, offset_s: float) -> Term:
    """One column of the file, from an offset on, as a `Term`."""
    coefficients = coefficients_through(record.accelerations_m_per_s2[:, column])
    offset = round(offset_s * record.rate_hz)

    def term(block: int) -> NDArray[np.float64]:
        first = offset + block * BLOCK_KNOTS - 2
        index = np.arange(first, first + BLOCK_KNOTS + DEGREE)
        # beyond its ends the series is mirrored, as the coefficients are; no run reaches them
        period = 2 * (len(coefficients) - 1)
        index = np.abs((index + period // 2) % period - period // 2)
        return np.asarray(coefficients[index])

    return term


def _check_length(settings: SimulationSettings, end_s: float) -> None:
    truth = settings.ground
    if end_s <= 0 or (settings.max_duration_s is not None and settings.max_duration_s > end_s):
        run = "any run" if settings.max_duration_s is None else f"{settings.max_duration_s:g} s of a run"
        raise ConfigurationError(
            f"simulation.ground.file = {str(truth.file)!r}: from file_offset_s = {truth.file_offset_s:g} on "
            f"it lasts {end_s:.6g} s, too short for {run}; take a longer file, or a smaller file_offset_s"
        )


def _base_tilt(truth: GroundTruth, mode: int) -> Callable[[NDArray[np.float64]], NDArray[np.float64]] | None:
    """Steady tilt of the base plus its step, in rad, as a function of time; None if there is neither."""
    slow = mode == SLOW
    rate = truth.tilt_slow_arcsec_per_min if slow else truth.tilt_fast_arcsec_per_min
    step = truth.tilt_step_slow_arcsec if slow else truth.tilt_step_fast_arcsec
    at_s = math.inf if truth.tilt_step_at_s is None else truth.tilt_step_at_s
    if not rate and not (step and math.isfinite(at_s)):
        return None

    def tilt_rad(times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        fraction = np.clip((times_s - at_s) / _STEP_DURATION_S, 0, 1)
        return np.asarray(ARCSEC_RAD * (rate * times_s / 60 + step * np.sin(0.5 * np.pi * fraction) ** 2))

    return tilt_rad


class SeismometerSamples(NamedTuple):
    """Simulated times (n,) in s, and counts (n, 2) along the slow and the fast swing."""

    time_s: NDArray[np.float64]
    counts: NDArray[np.float64]


class SimulatedSeismometer:
    """An auxiliary seismometer: samples the ground at an even rate, with a delay and white noise of its own.

    Raises ConfigurationError where no ground is simulated.
    """

    def __init__(self, settings: SimulationSettings) -> None:
        if settings.ground.model == "none":
            raise ConfigurationError(
                "a simulated seismometer feels the simulated ground: set simulation.ground.model"
            )
        self._settings = settings
        self._run = -1
        self._acceleration_m_per_s2: Sequence[SmoothSeries] = ()
        self._noise = np.random.default_rng()
        self._next = 0

    def until(self, time_s: float, run: int) -> SeismometerSamples:
        """The samples since the last call, up to a time of a run; they begin anew with another run."""
        truth = self._settings.seismometer
        if run != self._run:
            ground = ground_of(self._settings, run)
            assert ground is not None
            self._acceleration_m_per_s2, self._run, self._next = ground.acceleration_m_per_s2, run, 0
            self._noise = np.random.default_rng([self._settings.seed, run, _SEISMOMETER])
        last = int(np.floor(time_s * truth.rate_hz))
        times = np.arange(self._next, last + 1) / truth.rate_hz
        self._next = max(self._next, last + 1)
        past_s = np.maximum(times - truth.delay_s, 0.0)
        values = np.column_stack([series.at(past_s) for series in self._acceleration_m_per_s2])
        size = truth.noise_m_per_s2_per_sqrt_hz * np.sqrt(0.5 * truth.rate_hz)
        values = values + size * self._noise.standard_normal((len(times), 2))
        return SeismometerSamples(times, truth.counts_per_m_per_s2 * values)
