"""What the residuals of an exact fit, and its columns, do where something else were a little different."""

from collections.abc import Callable, Mapping

import numpy as np

from processing.arrays import Floats
from processing.fit.exact_model import ExactModel


def by_amplitudes(model: ExactModel, columns: Floats, errors: Floats) -> Floats:
    """Changes (2 points, m) of the residuals where measured amplitudes grow by `errors` (points, m)."""
    relative = errors / model.reference
    unmoved = np.zeros((len(model.beside_here(columns)[0]), relative.shape[1]))
    if model.is_free:
        of_amplitudes = -relative / model.u_amplitude[:, None]
        return np.concatenate([of_amplitudes, np.zeros_like(of_amplitudes), unmoved])
    before = model(columns)[0]
    changes = []
    for change in relative.T:
        moved = model.measuring_more(change, np.zeros_like(change))
        changes.append(moved(columns)[0] - before)
    return np.asarray(changes, dtype=np.float64).T


def by_times(model: ExactModel, columns: Floats, errors_s: Floats) -> Floats:
    """Changes (residuals,) for a unit of errors (points,) that measured times have more."""
    unmoved = np.zeros(len(model.beside_here(columns)[0]))
    if model.is_free:
        of_times = -errors_s / model.points.u_time_s
        return np.concatenate([np.zeros_like(of_times), of_times, unmoved])
    # a small step: a filter with a limit is linear only there
    step = 1e-3 * float(np.median(model.points.u_time_s)) / max(float(np.max(np.abs(errors_s))), 1e-300)
    moved = model.measuring_more(np.zeros_like(errors_s), step * errors_s)
    return np.asarray((moved(columns)[0] - model(columns)[0]) / step)


def by_loss(
    model: ExactModel, columns: Floats, loss: Callable[[Floats], Floats], values: Mapping[str, float]
) -> Floats:
    """Derivatives of the residuals by the size of a further loss (see `ExactModel.filtered`).

    `values` are added to the law's own for the waveform that belongs to a size of 1.
    """
    of_points = model.filtered_here(columns, loss=loss).jacobian[:, -1]
    before = model.of_evidence(columns)
    after = model.of_evidence(columns, values)
    return np.concatenate([of_points, model.scale * (after - before)])


def by_log_rho(model: ExactModel, columns: Floats) -> Floats:
    """Derivative of the fitted columns by ln(R/a), by linearised least squares."""
    both = model.filtered_here(columns, with_rho=True).jacobian
    beside = model.beside_here(columns)[1]
    both = np.concatenate([both, np.column_stack([beside, np.zeros(len(beside))])])
    return np.asarray(-np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=1e-12)[0], dtype=np.float64)
