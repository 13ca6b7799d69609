"""The Cramer-Rao bound of a decay's fit, at the truth."""

import numpy as np
from numpy.typing import NDArray

from processing.contact import ContactParameters
from processing.fit.exact_model import ExactModel
from processing.least_squares import covariance_of
from processing.swing import TurningPoints
from tests.processing.fit.decays import truth

Floats = NDArray[np.float64]


def true_columns(model: ExactModel, parameters: ContactParameters, points: TurningPoints) -> Floats:
    """The columns of a model for a decay of these parameters that begins with these points."""
    known = dict(zip(model.names, truth(parameters, model.names), strict=False))
    known |= {"initial_amplitude_rad": float(points.amplitude[0]), "start_time_s": float(points.time_s[0])}
    return np.asarray(model.columns.from_physical(known))


def bound(model: ExactModel, columns: Floats, jacobian: Floats) -> Floats:
    """Standard deviations of the parameters, in the order of the model's names."""
    matrix = model.columns.physical(columns)[1]
    return np.asarray(np.sqrt(np.diag(matrix @ covariance_of(jacobian) @ matrix.T)))
