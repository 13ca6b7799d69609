"""Spectra of the drive of the pendulum, from its turning points and from an auxiliary seismometer.

From one turning point to the next an acceleration f moves amplitude and time by two integrals
(`known_drive`). Together they are one complex number, ``int f exp(-i w t) dt / w`` over the half-swing:
f demodulated at the pendulum's frequency, twice in a period. Its spectrum is that of f on both sides of that
frequency.
"""

from dataclasses import dataclass, replace
from math import nan
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Flags, Floats
from processing.contact import PendulumOnBall
from processing.decay_summary import mean_period
from processing.fit.ground import density_of_step
from processing.fit.known_drive import KnownDrive
from processing.fit.result import FitResult
from processing.fit.seismometer_terms import fitted_state, model_of
from processing.quantity import Quantity
from processing.swing import TurningPoints

_MAX_STRETCH, _MIN_STRETCH = 64, 16
"""Most and fewest half-swings of a stretch, which gives one spectrum."""
_WANTED_STRETCHES = 6
"""Stretches into which a run is divided where it is long enough: fewer give no coherence."""
_MAX_DETUNING = 0.5
"""Detuning, in the pendulum's frequencies, up to which spectra are given: beyond it the integral over a
half-swing responds to frequencies of the other side as well."""
_COHERENCE_DETUNING = 0.1
"""Detuning within which the coherence is averaged to one number."""
_DRIVE = Quantity("", "", unit="rad/s^2/sqrt(Hz)")


@dataclass(frozen=True, slots=True, kw_only=True)
class SeismometerSpectra:
    """Spectral densities of angular acceleration near the pendulum's frequency, all of one length.

    Attributes
    ----------
    frequency_hz
        Rising, on both sides of the pendulum's.
    pendulum
        Drive of the pendulum from one turning point to the next, the noise of their measurement included.
    seismometer
        Drive by the auxiliary seismometer's prediction.
    left
        Drive of the pendulum less the prediction.
    measurement
        Drive that the stated uncertainties of the turning points alone would feign.
    coherence
        Squared coherence of the pendulum's drive with the prediction.
    stretches
        Number of stretches of the run over which the spectra are averaged. Unrelated signals have a squared
        coherence of about one over this number.
    coherence_near
        The squared coherence within a tenth of the pendulum's frequency, weighted by the pendulum's drive.
    """

    frequency_hz: Annotated[tuple[float, ...], Quantity("", "frequency", unit="Hz")] = ()
    pendulum_rad_per_s2_rthz: Annotated[tuple[float, ...], _DRIVE] = ()
    seismometer_rad_per_s2_rthz: Annotated[tuple[float, ...], _DRIVE] = ()
    left_rad_per_s2_rthz: Annotated[tuple[float, ...], _DRIVE] = ()
    measurement_rad_per_s2_rthz: Annotated[tuple[float, ...], _DRIVE] = ()
    coherence: Annotated[tuple[float, ...], Quantity("", "squared coherence")] = ()
    stretches: int = 0
    coherence_near: Annotated[float, Quantity("", "squared coherence near the pendulum's frequency")] = nan


def seismometer_spectra(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult
) -> SeismometerSpectra | None:
    """Spectra of a fit with an auxiliary seismometer; None for a run that is too short."""
    drive = fit.evidence.drive
    assert drive is not None
    half_period_s = mean_period(points) / 2
    usable = _usable(points, drive)
    length = _stretch_length(int(np.count_nonzero(usable)))
    if length == 0:
        return None
    observed = np.conj(_steps(points, pendulum, fit, drive.with_gains(np.zeros(drive.terms))))
    remainder = np.conj(_steps(points, pendulum, fit, drive))
    parts = _stretches(usable, length)
    if len(parts) < 2:
        return None
    window = np.hanning(length)

    def spectrum(steps: NDArray[np.complex128]) -> NDArray[np.complex128]:
        cut = np.stack([steps[part] for part in parts]) * window
        return np.asarray(np.fft.fftshift(np.fft.fft(cut, axis=1), axes=1) / np.sqrt(np.sum(window**2)))

    observed_spectrum, remainder_spectrum = spectrum(observed), spectrum(remainder)
    seismometer_spectrum = observed_spectrum - remainder_spectrum
    powers = [
        np.mean(np.abs(one) ** 2, axis=0)
        for one in (observed_spectrum, seismometer_spectrum, remainder_spectrum)
    ]
    cross = np.mean(observed_spectrum * np.conj(seismometer_spectrum), axis=0)
    nu = np.fft.fftshift(np.fft.fftfreq(length))
    # an error of a turning point is in the step to it and, with the other sign, in the step from it
    measured = _measurement(points) * 4 * np.sin(np.pi * nu) ** 2
    shown = np.abs(2 * nu) <= _MAX_DETUNING
    frequency = (1 + 2 * nu) / (2 * half_period_s)

    def density(power: Floats) -> tuple[float, ...]:
        # either quadrature has half of the power
        unit = density_of_step(1.0, half_period_s)
        return tuple((unit * np.sqrt(0.5 * power[shown])).tolist())

    squared = np.abs(cross) ** 2 / (powers[0] * powers[1])
    near = np.abs(2 * nu) <= _COHERENCE_DETUNING
    return SeismometerSpectra(
        frequency_hz=tuple(frequency[shown].tolist()),
        pendulum_rad_per_s2_rthz=density(powers[0]),
        seismometer_rad_per_s2_rthz=density(powers[1]),
        left_rad_per_s2_rthz=density(powers[2]),
        measurement_rad_per_s2_rthz=density(measured),
        coherence=tuple(squared[shown].tolist()),
        stretches=len(parts),
        coherence_near=float(np.average(squared[near], weights=powers[0][near])),
    )


def _steps(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult, drive: KnownDrive
) -> NDArray[np.complex128]:
    """Complex step (rad) from each measured turning point to the next that law and drive do not explain.

    The steps are the innovations of a filter that takes each measurement as the state.
    """
    model = model_of(points, pendulum, fit, drive)
    columns, noise = fitted_state(model, fit)
    as_measured = np.tile([1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0], (len(points), 1))
    found = model.filtered(columns, replace(noise, limit=np.inf), as_measured).residuals
    amplitude, time_s = np.split(-found, 2)
    rate = 2 * np.pi / mean_period(points)
    return np.asarray(rate * points.amplitude * time_s - 1j * amplitude * model.reference)


def _usable(points: TurningPoints, drive: KnownDrive) -> Flags:
    """Whether each turning point follows its neighbour by one half-swing that the seismometer covers."""
    follows = np.diff(points.index, prepend=points.index[0] - 2) == 1
    return np.asarray(follows & ~drive.missing[points.index - points.index[0]])


def _stretch_length(usable: int) -> int:
    """Half-swings of a stretch, a power of 2; 0 for too few."""
    most = 2 * usable // (_WANTED_STRETCHES + 1)
    return 0 if most < _MIN_STRETCH else min(_MAX_STRETCH, 1 << (most.bit_length() - 1))


def _stretches(usable: Flags, length: int) -> list[slice]:
    """Stretches without a gap, each half over the one before."""
    found, begin = [], 0
    while begin + length <= len(usable):
        lost = np.flatnonzero(~usable[begin : begin + length])
        if len(lost):
            begin += int(lost[-1]) + 1
        else:
            found.append(slice(begin, begin + length))
            begin += length // 2
    return found


def _measurement(points: TurningPoints) -> float:
    """Variance of the complex step by the error of one turning point, rad^2."""
    of_time = 2 * np.pi / mean_period(points) * points.amplitude * points.u_time_s
    return float(np.mean(points.u_amplitude**2 + of_time**2))
