"""How far the spot may move before it leaves the sensor."""

from dataclasses import dataclass

import numpy as np

from processing.arrays import Floats


@dataclass(frozen=True)
class Room:
    """The rest positions at which the spot is on the sensor: a polygon of tilts (X, Y).

    `normals` (n, 2) are unit vectors towards its edges, `distances_arcsec` (n,) those of the edges from zero
    tilt.
    """

    normals: Floats
    distances_arcsec: Floats

    def holds(self, rest_arcsec: Floats) -> bool:
        """Whether a rest position (2,) lies on the sensor."""
        return bool(np.all(self.normals @ rest_arcsec <= self.distances_arcsec))

    def largest_swing_arcsec(self, rest_arcsec: Floats, u_arcsec: Floats) -> Floats:
        """Largest amplitude along Y with which the spot stays on the sensor; negative: it is off it at rest.

        `rest_arcsec` and `u_arcsec` (..., 2): predicted rest positions and their standard uncertainties, of
        which two are kept clear. Returns (...,).
        """
        doubt = 2.0 * np.sqrt(u_arcsec**2 @ (self.normals**2).T)
        left = self.distances_arcsec - rest_arcsec @ self.normals.T - doubt
        along = np.abs(self.normals[:, 1])
        # an edge along which the pendulum swings limits no amplitude, only the rest position
        swing = np.where(
            (left < 0) | (along < 0.02), np.where(left < 0, left, np.inf), left / np.maximum(along, 0.02)
        )
        return np.asarray(np.min(swing, axis=-1))
