"""Sensor noise by photon transfer: gain, read noise, full well, linearity, dark level, PRNU, hot pixels.

Half the variance of the difference of two frames of the same scene is the temporal noise variance; patterns
of scene and pixels cancel. It grows linearly with the signal, with the slope 1 / gain (gain in e-/DN).
Definitions follow EMVA Standard 1288 (photon transfer curve, section 6).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.birge import birge_ratio
from processing.arrays import Flags, Floats, Ints
from processing.errors import DataError
from processing.noise_models import robust_scatter

Image = NDArray[np.uint8] | NDArray[np.uint16]

_QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole numbers."""
_MIN_RESOLVED_DN = 0.24
"""Smallest temporal noise in the dark that can be measured in spite of rounding to integers (EMVA 1288)."""
_MIN_SIGNAL_U, _MIN_SIGNAL_DN = 5.0, 0.02
"""A level is lit if its mean exceeds that of the dark frames by so many standard uncertainties, and DN."""
_MIN_SLOPE_U = 5.0
"""Smallest slope, in its standard uncertainties, that gives a gain (to 20 %)."""
_U_NON_LINEARITY = 0.01
"""Standard uncertainty of the fraction by which the response at full scale differs from a straight one."""
_MIN_LEVELS = 4
"""Smallest number of levels; beside a straight line, two degrees of freedom show whether it is one."""
_MAX_FITTED_FRACTION = 0.7
"""Fraction of saturation up to which the gain is fitted (EMVA 1288)."""
_MAX_CLIPPED_FRACTION = 1e-4
"""Largest fraction of pixels at full scale of a pair that is used."""


@dataclass(frozen=True, slots=True)
class TransferPoint:
    """Mean signal above the dark level and temporal noise variance of one pair of frames."""

    pair: int
    """Index of the pair."""
    name: str
    signal_dn: float
    variance_dn2: float
    u_variance_dn2: float


@dataclass(frozen=True, slots=True)
class SensorCalibration:
    """Result of a photon transfer measurement. `u_` are standard uncertainties."""

    gain_e_per_dn: float
    u_gain_e_per_dn: float
    read_noise_e: float
    u_read_noise_e: float
    read_noise_resolved: bool
    """False if rounding hides the noise in the dark; read noise and dark level are then uncertain."""
    dark_level_dn: float
    """Mean value without light, the tracker's pedestal."""
    u_dark_level_dn: float
    full_well_e: float
    """A lower limit if `saturates` is False."""
    saturates: bool
    """Whether a level was bright enough to saturate pixels."""
    linearity_error: float
    """Largest relative deviation of the signal from a line in the exposure; NaN with fewer than three."""
    non_linearity: float
    """Fraction by which the signal at full scale is below a line, from the noise of the levels."""
    prnu: float
    """Relative standard deviation of the pixels' responses (photo response non-uniformity)."""
    u_prnu: float
    chi2_per_dof: float
    points: tuple[TransferPoint, ...]
    """Levels that were used."""
    hot_pixels: Ints
    """Coordinates (n, 2), x and y, of pixels with a high dark value."""
    rejected: tuple[str, ...]
    """Names of the pairs that were not used, with the reasons."""


def photon_transfer(
    flats: Sequence[tuple[Image, Image]],
    darks: Sequence[Image],
    full_scale_dn: int,
    *,
    names: Sequence[str] = (),
    exposures_us: Sequence[float] = (),
) -> SensorCalibration:
    """Gain, read noise and further properties from pairs of uniformly lit frames and dark frames.

    Parameters
    ----------
    flats
        Pairs of frames (ny, nx) in DN, each pair at one exposure and one illumination, at levels from nearly
        dark to nearly full scale.
    darks
        Two or more frames (ny, nx) without light.
    full_scale_dn
        Largest value of a pixel; pairs with pixels at it are rejected.
    names
        Names of the pairs in messages; numbers by default.
    exposures_us
        Exposure of each pair, for the linearity; the light must then be constant. Empty: not determined.

    Raises
    ------
    DataError
        Fewer than two dark frames, fewer than four usable levels (the message lists the reasons for which
        others were rejected: saturated, unstable lamp, no light), or a noise that does not grow with the
        signal.
    """
    if len(darks) < 2:
        raise DataError(
            f"sensor: {len(darks)} dark frames, at least 2 are needed; cover the sensor and take more"
        )
    dark_stack = np.stack([np.asarray(image, dtype=np.float64) for image in darks])
    dark_map = dark_stack.mean(axis=0)
    # hot pixels have more temporal noise than others, and are left out of all averages
    hot = _hot_pixels(dark_map)
    cold = np.ones(dark_map.size, dtype=bool)
    cold[hot] = False
    dark_values = dark_stack.reshape(len(darks), -1)[:, cold]
    dark_variance, u_dark_variance = _temporal_variance(dark_values)
    resolved = dark_variance - _QUANTISATION_DN2 > _MIN_RESOLVED_DN**2
    dark_level = _unrounded_mean(dark_values) if resolved else float(dark_values.mean())
    u_dark_variance = float(np.hypot(u_dark_variance, _u_rounding(dark_variance)))
    points: list[TransferPoint] = []
    rejected: list[str] = []
    saturated_level = 0.0
    for pair, (first, second) in enumerate(flats):
        name = names[pair] if pair < len(names) else f"pair {pair + 1}"
        a = np.asarray(first, dtype=np.float64).reshape(-1)[cold]
        b = np.asarray(second, dtype=np.float64).reshape(-1)[cold]
        clipped = float(np.mean((a >= full_scale_dn) | (b >= full_scale_dn)))
        signal = 0.5 * (a.mean() + b.mean()) - dark_level
        if clipped > _MAX_CLIPPED_FRACTION:
            saturated_level = max(saturated_level, signal)
            rejected.append(f"{name}: {100 * clipped:.3g} % of the pixels at full scale")
            continue
        difference = a - b
        shift = float(difference.mean())
        noise = float(difference.std())
        u_signal = np.sqrt((0.25 * noise**2 + dark_variance / len(darks)) / len(a))
        if noise == 0.0 or signal <= max(_MIN_SIGNAL_U * u_signal, _MIN_SIGNAL_DN):
            reason = "its two frames are equal" if noise == 0.0 else "not brighter than the dark frames"
            rejected.append(f"{name}: {reason} (signal {signal:.3g} DN)")
            continue
        if abs(shift) > max(0.01 * signal, 5.0 * noise / np.sqrt(len(a)), 0.002 * signal + 0.02):
            rejected.append(
                f"{name}: the means of the two frames differ by {100 * abs(shift) / max(signal, 1e-9):.2g} % "
                "(unstable lamp)"
            )
            continue
        variance = 0.5 * float(difference.var(ddof=1))
        kurtosis = float(np.mean((difference - shift) ** 4) / difference.var() ** 2)
        u_variance = variance * np.sqrt((kurtosis - 1.0) / len(a))
        points.append(TransferPoint(pair, name, float(signal), variance, float(u_variance)))
    knee = _knee(points)
    if knee is not None:
        saturated_level = max(saturated_level, knee) if saturated_level == 0 else min(saturated_level, knee)
        rejected += [
            f"{point.name}: the noise is lower than at smaller signals, so pixels are saturated"
            for point in points
            if point.signal_dn > knee
        ]
        points = [point for point in points if point.signal_dn <= knee]
    max_dn = _MAX_FITTED_FRACTION * full_scale_dn
    if knee is not None:
        max_dn = min(max_dn, _MAX_FITTED_FRACTION * knee + dark_level)
    fitted = [point for point in points if point.signal_dn + dark_level <= max_dn]
    if len(fitted) < _MIN_LEVELS:
        detail = f"; not usable: {'; '.join(rejected)}" if rejected else ""
        raise DataError(
            f"sensor: {len(fitted)} usable levels up to {100 * _MAX_FITTED_FRACTION:.0f} % of full scale, "
            f"at least {_MIN_LEVELS} are needed{detail}"
        )
    slope, u_slope, intercept, u_intercept, chi2_per_dof, non_linearity = _line(
        fitted, dark_variance if resolved else None, u_dark_variance, full_scale_dn
    )
    gain = 1.0 / slope
    read_variance = max(intercept - _QUANTISATION_DN2, 0.0)
    read_noise_dn = float(np.sqrt(read_variance))
    u_read_dn = u_intercept / (2.0 * read_noise_dn) if read_noise_dn > 0 else float(np.sqrt(u_intercept))
    brightest = max(points, key=lambda point: point.signal_dn)
    prnu, u_prnu = _prnu(flats[brightest.pair], brightest, dark_map, cold, dark_variance / len(darks))
    exposures = [exposures_us[point.pair] for point in points] if exposures_us else []
    u_mean = np.sqrt(dark_variance / (len(darks) * cold.sum()))
    return SensorCalibration(
        gain_e_per_dn=gain,
        u_gain_e_per_dn=gain * u_slope / slope,
        read_noise_e=read_noise_dn * gain,
        u_read_noise_e=float(np.hypot(u_read_dn * gain, read_noise_dn * gain * u_slope / slope)),
        read_noise_resolved=bool(resolved),
        dark_level_dn=dark_level,
        u_dark_level_dn=float(np.hypot(u_mean, 0.0 if resolved else 0.5 / np.sqrt(3.0))),
        full_well_e=max(brightest.signal_dn, saturated_level) * gain,
        saturates=saturated_level > 0,
        linearity_error=_linearity(points, exposures),
        non_linearity=non_linearity,
        prnu=prnu,
        u_prnu=u_prnu,
        chi2_per_dof=chi2_per_dof,
        points=tuple(points),
        hot_pixels=np.column_stack(np.unravel_index(hot, dark_map.shape)[::-1]).astype(np.int64),
        rejected=tuple(rejected),
    )


def _hot_pixels(dark_map: Floats) -> Ints:
    """Flat indices of pixels more than 8 robust standard deviations above the median."""
    flat = dark_map.reshape(-1)
    middle = float(np.median(flat))
    sigma = max(robust_scatter(flat, middle), float(np.percentile(flat, 84) - middle), 0.2)
    return np.nonzero(flat > middle + 8.0 * sigma)[0]


def _unrounded_mean(values: Floats) -> float:
    """Mean, by maximum likelihood, of normal values that were rounded to integers, none below 0. The mean of
    the integers is wrong by up to 0.1 DN for a noise of 0.24 DN."""
    from scipy.optimize import minimize
    from scipy.special import ndtr

    codes, counts = np.unique(values, return_counts=True)
    below = np.where(codes > 0, codes - 0.5, -np.inf)

    def loss(p: Floats) -> float:
        sigma = np.exp(p[1])
        probability = ndtr((codes + 0.5 - p[0]) / sigma) - ndtr((below - p[0]) / sigma)
        return -float(counts @ np.log(np.maximum(probability, 1e-300))) / values.size

    start = [values.mean(), np.log(values.std())]
    return float(minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-12}).x[0])


def _temporal_variance(stack: Floats) -> tuple[float, float]:
    """Temporal variance and its standard uncertainty; offsets common to all pixels of a frame are removed."""
    frames, pixels = stack.shape
    residual = stack - stack.mean(axis=1, keepdims=True)
    residual -= residual.mean(axis=0, keepdims=True)
    dof = (frames - 1) * (pixels - 1)
    variance = float(np.sum(residual**2)) / dof
    kurtosis = float(np.mean(residual**4) / np.mean(residual**2) ** 2) if variance > 0 else 3.0
    return variance, variance * float(np.sqrt((kurtosis - 1.0) / dof))


def _u_rounding(variance: float) -> float:
    """Standard uncertainty of a variance after rounding, because rounding does not add exactly 1/12 DN^2.

    It is the largest deviation divided by sqrt(2), for the smallest true variance that, with this deviation,
    could have given the measured one: a noise that rounding enlarged suggests too small a deviation.
    """
    from scipy.optimize import brentq

    measured = variance - _QUANTISATION_DN2
    smallest = 0.0
    if measured > _largest_deviation(0.0):
        # the largest variance that a true variance can give rises with it, so there is one root
        smallest = brentq(lambda true: true + _largest_deviation(true) - measured, 0.0, measured)
    return _largest_deviation(smallest) / float(np.sqrt(2.0))


def _largest_deviation(variance: float) -> float:
    """Largest deviation of the variance of rounded normal values from variance + 1/12 DN^2, over all means:
    first term of the series in B. Widrow, Quantization Noise, 2008."""
    return float((4.0 * variance + 1.0 / np.pi**2) * np.exp(-2.0 * np.pi**2 * variance))


def _knee(points: Sequence[TransferPoint]) -> float | None:
    """Signal of the largest noise, if larger signals have significantly less noise; otherwise None."""
    if not points:
        return None
    peak = max(points, key=lambda point: point.variance_dn2)
    falls = any(
        peak.variance_dn2 - point.variance_dn2 > 5.0 * np.hypot(peak.u_variance_dn2, point.u_variance_dn2)
        for point in points
        if point.signal_dn > peak.signal_dn
    )
    return peak.signal_dn if falls else None


def _line(
    points: Sequence[TransferPoint], dark_variance: float | None, u_dark_variance: float, full_scale_dn: int
) -> tuple[float, float, float, float, float, float]:
    """Weighted fit of variance = intercept + slope * signal, with the dark frames as a point at signal 0.

    A signal that is lower by the fraction e s, where s is its fraction of full scale, has a variance lower by
    the fraction 3 e s: e is fitted, with 0 and `_U_NON_LINEARITY` as prior mean and standard deviation.

    Returns slope, its uncertainty, intercept, its uncertainty, chi-square per degree of freedom, and e.
    """
    x = np.array([point.signal_dn for point in points])
    y = np.array([point.variance_dn2 for point in points])
    u = np.array([point.u_variance_dn2 for point in points])
    if dark_variance is not None:
        x, y, u = np.append(x, 0.0), np.append(y, dark_variance), np.append(u, u_dark_variance)
    u = np.maximum(u, 1e-12)
    # from the model, because uncertainties from measured variances favour those that are low by chance
    common = np.median(u[: len(points)] / y[: len(points)])
    curvature = np.zeros_like(x)
    for is_last in (False, False, False, True):
        design = np.column_stack([np.ones_like(x), x, curvature]) / u[:, None]
        design = np.vstack([design, [0.0, 0.0, 1.0 / _U_NON_LINEARITY]])
        measured = np.append(y / u, 0.0)
        values, *_ = np.linalg.lstsq(design, measured, rcond=None)
        curvature = -3.0 * values[1] * x**2 / full_scale_dn
        model = values[0] + values[1] * x + values[2] * curvature
        if not is_last and np.all(model > 0):
            u[: len(points)] = common * model[: len(points)]
    dof = len(x) - 2
    chi2_per_dof = float(np.sum((design @ values - measured) ** 2)) / dof
    covariance = np.linalg.inv(design.T @ design) * birge_ratio(chi2_per_dof * dof, dof) ** 2
    intercept, slope, non_linearity = values.tolist()
    u_intercept, u_slope, _ = np.sqrt(np.diag(covariance)).tolist()
    if not slope > _MIN_SLOPE_U * u_slope:
        raise DataError(
            f"sensor: the noise does not grow with the signal (slope {slope:.3g} ± {u_slope:.2g} DN); "
            "the two frames of each pair must be of the same constant light, and the levels reach to half of "
            "full scale or more"
        )
    return slope, u_slope, intercept, u_intercept, chi2_per_dof, non_linearity


def _prnu(
    pair: tuple[Image, Image], point: TransferPoint, dark_map: Floats, cold: Flags, u2_dark_map: float
) -> tuple[float, float]:
    """PRNU and its standard uncertainty, from one pair: spatial standard deviation over mean signal, without
    temporal noise and a quadratic surface, the slow variation of the illumination."""
    mean = 0.5 * (np.asarray(pair[0], dtype=np.float64) + np.asarray(pair[1], dtype=np.float64)) - dark_map
    ny, nx = mean.shape
    y, x = (coordinate.reshape(-1)[cold] for coordinate in np.mgrid[0 : 1 : ny * 1j, 0 : 1 : nx * 1j])
    design = np.column_stack([np.ones_like(x), x, y, x**2, x * y, y**2])
    values = mean.reshape(-1)[cold]
    surface, *_ = np.linalg.lstsq(design, values, rcond=None)
    variance = float((values - design @ surface).var(ddof=design.shape[1]))
    spatial = variance - 0.5 * point.variance_dn2 - u2_dark_map
    u_spatial = float(np.hypot(variance * np.sqrt(2.0 / len(values)), 0.5 * point.u_variance_dn2))
    if spatial <= 0:
        return 0.0, float(np.sqrt(u_spatial) / point.signal_dn)
    spread = np.sqrt(spatial)
    return float(spread / point.signal_dn), float(u_spatial / (2 * spread) / point.signal_dn)


def _linearity(points: Sequence[TransferPoint], exposures_us: Sequence[float]) -> float:
    """Largest relative deviation of the signal from a straight line that does not fall with the exposure."""
    if len(exposures_us) < 3:
        return float("nan")
    x = np.array(exposures_us)
    y = np.array([point.signal_dn for point in points])
    # EMVA 1288 minimises relative deviations, so that small signals count as much as large ones
    design = np.column_stack([np.ones_like(x), x]) / y[:, None]
    values, *_ = np.linalg.lstsq(design, np.ones_like(y), rcond=None)
    if values[1] < 0.0:
        # exposures in the wrong order may lie on a falling line; the best other one is level
        values = np.array([np.sum(1.0 / y) / np.sum(1.0 / y**2), 0.0])
    return float(np.max(np.abs(design @ values - 1.0)))
