"""Errors that many turning points share because the sensor has them at a place: what a fit says of them.

An error of place moves the amplitudes of all half-cycles that pass it. Residuals of whole cycles find it but
for what looks like a motion (`processing.position_map`); of the rest, the fitted law sees what no decay does.
An error of a rolling shutter's row time moves their times by their places.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.fit.apparatus import RigQuantities
from processing.fit.exact import fit_exact_with
from processing.fit.exact_model import ExactModel
from processing.fit.exact_sensitivities import by_amplitudes
from processing.fit.result import FitResult
from processing.least_squares import propagate
from processing.swing import TurningPoints

_FELT = 1e-3
"""Largest error of an amplitude, in its uncertainties, below which a direction is left as it is."""


class PlaceErrors(NamedTuple):
    """What a fit says of errors that it shares among its amplitudes.

    `values` (m,) and `covariance` (m, m) are those of the coordinates, which were 0 and 1 before the fit.
    `of_parameters` is the covariance that they add to the fit's values.
    """

    values: Floats
    covariance: Floats
    of_parameters: Floats


def place_errors(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult, errors: Floats
) -> PlaceErrors:
    """Errors and parameters that describe the turning points best together, near an exact fit.

    Parameters
    ----------
    points
        The turning points of the fit.
    errors : (points, m)
        Errors of the amplitudes for each of m independent coordinates of variance 1.

    Notes
    -----
    With the whitened residuals r and their derivatives J by the parameters and E by the coordinates z, and P
    the projection on what J leaves, ``z = -(1 + E^T P E)^-1 E^T P r``; the parameters change by ``-J^+ E z``.
    """
    model, columns = ExactModel.of(points, pendulum, fit)
    residuals, jacobian = model(columns)
    felt = np.max(np.abs(errors) / points.u_amplitude[:, None], axis=0) > _FELT
    by_errors = -by_amplitudes(model, columns, errors[: fit.half_cycles][:, felt])
    good = np.isfinite(residuals) & np.isfinite(jacobian).all(axis=1) & np.isfinite(by_errors).all(axis=1)
    residuals, jacobian, by_errors = residuals[good], jacobian[good], by_errors[good]
    size = np.sqrt(np.sum(jacobian**2, axis=0))
    directions, spread, turned = np.linalg.svd(jacobian / size, full_matrices=False)
    kept = spread > 1e-12 * spread[0]
    directions = directions[:, kept]
    left = residuals - directions @ (directions.T @ residuals)
    beside = by_errors - directions @ (directions.T @ by_errors)
    noise2 = 1.0
    for _ in range(2):
        # what the errors of place do not explain of the scatter is noise
        of_felt = np.linalg.inv(np.eye(len(beside.T)) + beside.T @ beside / noise2)
        found = -of_felt @ (beside.T @ left) / noise2
        noise2 = max(1.0, float(np.sum((left + beside @ found) ** 2)) / fit.dof)
    values, covariance = np.zeros(len(felt)), np.eye(len(felt))
    values[felt], covariance[np.ix_(felt, felt)] = found, of_felt
    of_columns = ((turned[kept].T / spread[kept]) @ (directions.T @ by_errors)) / size[:, None]
    to_physical = model.columns.physical(columns)[1]
    return PlaceErrors(values, covariance, propagate(to_physical, of_columns @ of_felt @ of_columns.T))


def with_place_errors(fit: FitResult, of_parameters: Floats, names: tuple[str, ...]) -> FitResult:
    """The fit with the covariance that errors of place add to the parameters `names`."""
    at = [names.index(name) for name in fit.names if name in names]
    own = [name in names for name in fit.names]
    added = np.zeros((len(fit.names), len(fit.names)))
    added[np.ix_(own, own)] = of_parameters[np.ix_(at, at)]
    reading = fit.reading_covariance
    return replace(
        fit,
        covariance=fit.covariance + added,
        reading_covariance=None if reading is None else reading + added,
        place_covariance=added,
    )


def by_row_time(
    points: TurningPoints, pendulum: PendulumOnBall, exact: FitResult, rig: RigQuantities
) -> Floats | None:
    """Derivatives (parameters,) of the contact parameters by the row time; None where it is not uncertain.

    Turning points at the two ends of the swing lie on rows above and below that of rest: a row time wrong by
    d makes the ones late by d times their distance in rows, the others as much early. Full periods keep
    their lengths but for friction. The points are fitted again, with the noise of the `exact` fit. Which end
    comes first is not known, and so the sign is not either.

    Raises DataError if a fit does not converge.
    """
    u_s = rig.row_time_s.u
    if u_s == 0:
        return None
    rows = np.tan(2.0 * points.amplitude) * rig.arm_m.value / rig.pitch_m.value
    rows *= np.cos(rig.slow_angle_rad.value) * (1 - 2 * (points.index % 2))
    moved = [replace(points, time_s=points.time_s + error_s * rows) for error_s in (-u_s, u_s)]
    return _slopes(moved, u_s, pendulum, exact)


def by_common_amplitude(
    points: TurningPoints, pendulum: PendulumOnBall, exact: FitResult, rig: RigQuantities
) -> Floats | None:
    """Derivatives (parameters,) of the contact parameters by what all amplitudes are too small by; None where
    that is not uncertain.

    The points are fitted again, with the noise of the `exact` fit. Raises DataError if a fit does not
    converge.
    """
    u_rad = rig.common_amplitude_rad.u
    if u_rad == 0:
        return None
    moved = [replace(points, amplitude=points.amplitude + error) for error in (-u_rad, u_rad)]
    return _slopes(moved, u_rad, pendulum, exact)


def by_amplitude_errors(
    points: TurningPoints, pendulum: PendulumOnBall, exact: FitResult, errors: Floats
) -> Floats:
    """Changes (parameters,) of the contact parameters by errors that amplitudes share, one standard
    uncertainty of all of them together.

    Parameters
    ----------
    points
        The turning points of the fit.
    errors : (points, m)
        Errors of the amplitudes for each of m independent coordinates of variance 1.

    Returns
    -------
    By their sizes, the standard uncertainties of the parameters; signs are those of the coordinate that
    changes them most.
    """
    model, columns = ExactModel.of(points, pendulum, exact)
    jacobian = model(columns)[1]
    by_errors = by_amplitudes(model, columns, errors[: exact.half_cycles])
    good = np.isfinite(jacobian).all(axis=1) & np.isfinite(by_errors).all(axis=1)
    size = np.sqrt(np.sum(jacobian[good] ** 2, axis=0))
    of_columns = -np.linalg.lstsq(jacobian[good] / size, by_errors[good], rcond=1e-12)[0] / size[:, None]
    at = [exact.names.index(name) for name in exact.contact_names]
    moved = (model.columns.physical(columns)[1] @ of_columns)[at]
    u = np.linalg.norm(moved, axis=1)
    main = np.linalg.svd(moved / np.where(u > 0, u, 1.0)[:, None], full_matrices=False)[0][:, 0]
    return np.asarray(np.copysign(u, main))


def _slopes(moved: Sequence[TurningPoints], by: float, pendulum: PendulumOnBall, exact: FitResult) -> Floats:
    """Derivatives of the contact parameters, from points that were moved by `-by` and by `by`."""
    fits = [fit_exact_with(points, pendulum, exact, drag=exact.has_drag) for points in moved]
    low, high = (fit.values[[fit.names.index(name) for name in fit.contact_names]] for fit in fits)
    slopes: Floats = (high - low) / (2.0 * by)
    return slopes
