"""Eq. 5 in closed form, and its inverse: the reference for `processing.contact.decay`.

    t(alpha) = (T/4) integral_alpha^alpha0 dphi / (c + b phi^p/(p+1))

Printed as 2F1(1, 1/p; 1+1/p; -z), z = b x^p / ((p+1) c), the closed form loses all digits or
divides by zero as c -> 0, p -> 0, p -> 1 and b -> 0. Two equivalent series do not: where z <= 2,
Pfaff's transformation gives one of positive terms; where z > 2, integration term by term gives
differences of powers whose limits are logarithms.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from processing.errors import DataError
from processing.kernel import kernel

_CHANGE_OF_SERIES = 2.0
"""z where one series hands over to the other; both converge at least like (2/3)^k around it."""


@kernel
def _from_zero(x: float, b: float, p: float, c: float) -> float:
    """integral_0^x dphi/(c + b phi^p), b x^p <= 2 c, by 2F1(1, 1; 1+1/p; z/(1+z))."""
    rate = c + b * x**p
    ratio = b * x**p / rate
    term, total = 1.0, 1.0
    for k in range(1, 400):
        term *= ratio * (p * k) / (p * k + 1)
        total += term
        if term < 1e-17 * total:
            break
    return float(x / rate * total)


@kernel
def _between(low: float, high: float, b: float, p: float, c: float) -> float:
    """integral_low^high dphi/(c + b phi^p), b low^p >= 2 c, term by term in c/(b phi^p)."""
    span = np.log(high / low)
    factor = 1 / (b * low**p)
    ratio = -c * factor
    total = 0.0
    scale = factor * low
    exponent = 1 - p
    fall = (low / high) ** p
    power = (high / low) * fall
    for _ in range(400):
        if abs(exponent * span) > 0.5:
            term = scale * (power - 1) / exponent
        elif abs(exponent) > 1e-300:
            term = scale * np.expm1(exponent * span) / exponent
        else:
            term = scale * span
        total += term
        if abs(term) < 1e-17 * abs(total):
            break
        scale *= ratio
        power *= fall
        exponent -= p
    return total


@kernel
def _elapsed(
    amplitude: NDArray[np.float64], start: float, b: float, p: float, c: float
) -> NDArray[np.float64]:
    """integral_amplitude^start dphi/(c + b phi^p) for an array; c, b >= 0, not both zero."""
    out = np.empty_like(amplitude)
    if b == 0:
        for i in range(len(amplitude)):
            out[i] = (start - amplitude[i]) / c
        return out
    if p == 0:
        for i in range(len(amplitude)):
            out[i] = (start - amplitude[i]) / (c + b)
        return out
    log_change = np.log(_CHANGE_OF_SERIES * c / b) / p if c > 0 else -np.inf
    change = np.exp(log_change) if log_change < 700 else np.inf
    for i in range(len(amplitude)):
        low, high, sign = amplitude[i], start, 1.0
        if low > high:
            low, high, sign = high, low, -1.0
        if low == 0 and c == 0:
            # The swing dies in finite time only where the loss falls slower than the amplitude.
            out[i] = high ** (1 - p) / ((1 - p) * b) if p < 1 else np.inf
            continue
        total = 0.0
        if high > change:
            total += _between(max(low, change), high, b, p, c)
        if low < change:
            total += _from_zero(min(high, change), b, p, c) - _from_zero(low, b, p, c)
        out[i] = sign * total
    return out


def decay_time(
    amplitude: ArrayLike, initial_amplitude: float, *, b: float, p: float, c: float, period_s: float
) -> NDArray[np.float64]:
    """Time at which the amplitude has fallen to a value: Eq. 5 in closed form.

    Parameters
    ----------
    amplitude, initial_amplitude
        Positive, one unit (rad where b and c are those of `ContactParameters`); amplitude 0 is
        the end of the swing, infinitely late where c = 0 and p >= 1.
    b, p, c
        Friction of Eq. 1, none negative, b and c not both zero.
    period_s
        T of Eq. 5, taken as constant.

    Returns
    -------
    Seconds, of the shape of `amplitude`; negative above the initial amplitude.
    """
    if min(b, p, c) < 0 or b + c <= 0:
        raise DataError(
            f"Eq. 5 with b = {b:g}, p = {p:g}, c = {c:g}: none may be negative, b and c not both 0"
        )
    alpha = np.asarray(amplitude, dtype=np.float64)
    if not initial_amplitude > 0 or not np.all(alpha >= 0):
        raise DataError("Eq. 5 takes amplitudes that are not negative and an initial one above zero")
    flat = np.ascontiguousarray(alpha.reshape(-1))
    return (period_s / 4) * _elapsed(flat, float(initial_amplitude), b / (p + 1), p, c).reshape(alpha.shape)


@kernel
def _invert(elapsed: NDArray[np.float64], start: float, b: float, p: float, c: float) -> NDArray[np.float64]:
    """Amplitude after the given integrals: safeguarded Newton in the amplitude itself."""
    out = np.empty_like(elapsed)
    at = np.empty(1)
    for i in range(len(elapsed)):
        low, high = 0.0, start
        at[0] = 0.0
        end = _elapsed(at, start, b, p, c)[0]
        if elapsed[i] >= end:
            out[i] = 0.0 if elapsed[i] == end else np.nan
            continue
        while elapsed[i] < 0:
            at[0] = high
            if _elapsed(at, start, b, p, c)[0] <= elapsed[i]:
                break
            low, high = high, 2 * high
        x = out[i - 1] if i > 0 and low < out[i - 1] < high else min(high, start)
        for _ in range(200):
            at[0] = x
            error = _elapsed(at, start, b, p, c)[0] - elapsed[i]
            if error > 0:
                low = x
            else:
                high = x
            following = x + error * (c + b * x**p)
            if not low < following < high:
                following = 0.5 * (low + high)
            if abs(following - x) <= 4e-16 * x:
                x = following
                break
            x = following
        out[i] = x
    return out


def decay_amplitude(
    time_s: ArrayLike, initial_amplitude: float, *, b: float, p: float, c: float, period_s: float
) -> NDArray[np.float64]:
    """Amplitude after a time: the inverse of `decay_time`, NaN once the swing has ended."""
    if min(b, p, c) < 0 or b + c <= 0:
        raise DataError(
            f"Eq. 5 with b = {b:g}, p = {p:g}, c = {c:g}: none may be negative, b and c not both 0"
        )
    if not initial_amplitude > 0:
        raise DataError(f"initial amplitude {initial_amplitude}: it must be positive")
    time = np.asarray(time_s, dtype=np.float64)
    flat = np.ascontiguousarray(time.reshape(-1)) * (4 / period_s)
    return _invert(flat, float(initial_amplitude), b / (p + 1), p, c).reshape(time.shape)
