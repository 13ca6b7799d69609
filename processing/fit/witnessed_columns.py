"""The columns of a law beside the gains of a witness, so that both are fitted together."""

from collections.abc import Mapping, Sequence

import numpy as np

from processing.arrays import Floats
from processing.contact import Columns, HeldColumn
from processing.fit.known_drive import KnownDrive
from processing.swing import TurningPoints

NOT_WITNESSED = np.empty((2, 0)), np.empty((2, 0, 0)), np.empty(0)
"""What the filter is given where nothing is known of the drive."""


LEAST_LEFT = 0.022
"""What any witness leaves of a drive, as a part of it: that of two seismometers of different make at one
place, at 0.2 to 0.28 Hz. The measurement of the turning points hides so weak a drive, and yet it adds up."""


class WitnessedColumns:
    """A law's columns after those of the gains; see `Columns`.

    The gains are no parameters of the law: `physical` has its values alone, and their covariance follows from
    that of all columns. Gains are in `unit`, with which a drive moves an amplitude by the reference.
    """

    def __init__(self, law: Columns, drive: KnownDrive) -> None:
        self._law, self._drive = law, drive
        self.reference = law.reference
        self.map_by_log_rho = law.map_by_log_rho
        self.terms = drive.terms
        self.valley = None if law.valley is None else law.valley + self.terms
        open_end = np.full(self.terms, np.inf)
        self.lower = np.concatenate([-open_end, law.lower])
        self.upper = np.concatenate([open_end, law.upper])
        # a gain of 1 then moves an amplitude by the reference
        size = np.sqrt(np.mean(drive.steps[0] ** 2, axis=0))
        self.unit = law.reference / np.where(size > 0.0, size, 1.0)

    def witnessed_by(self, drive: KnownDrive) -> "WitnessedColumns":
        """The same law beside another drive."""
        return WitnessedColumns(self._law, drive)

    def gains(self, columns: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Gains (terms,) in rad/s^2 per unit of the signals, and their covariance."""
        part = slice(self.terms)
        return columns[part] * self.unit, covariance[part, part] * np.outer(self.unit, self.unit)

    def known(self, columns: Floats, width: int) -> tuple[Floats, Floats, Floats]:
        """What the filter is given of the drive, in units of the reference, for a Jacobian of `width`."""
        steps = self._drive.steps * (self.unit / self.reference)
        gains = columns[: self.terms]
        by = np.zeros((*steps.shape[:2], width))
        by[:, :, : self.terms] = steps
        unknown = self._drive.unknown_variance(gains * self.unit) / self.reference**2
        return np.ascontiguousarray(steps @ gains), by, unknown

    def least_left(self, columns: Floats) -> float:
        """The least step of the drive that is left, in units of the reference."""
        known = self.known(columns, self.terms)[0][0]
        seen = known[~self._drive.missing]
        return LEAST_LEFT * float(np.sqrt(np.mean(seen**2))) if len(seen) else 0.0

    def map_parameters(self, columns: Floats) -> tuple[Floats, Floats]:
        values, matrix = self._law.map_parameters(columns[self.terms :])
        return values, self._beside(matrix)

    def physical(self, columns: Floats) -> tuple[Floats, Floats]:
        values, matrix = self._law.physical(columns[self.terms :])
        return values, self._beside(matrix)

    def from_physical(self, values: Mapping[str, float]) -> Floats:
        return self._with_gains(self._law.from_physical(values))

    def starts(self, points: TurningPoints) -> Sequence[Sequence[Floats]]:
        return [[self._with_gains(one) for one in group] for group in self._law.starts(points)]

    def held(self, name: str) -> HeldColumn:
        column, keeps_sign = self._law.held(name)
        return HeldColumn(column + self.terms, keeps_sign)

    def at_limit(self, columns: Floats) -> Sequence[str]:
        return self._law.at_limit(columns[self.terms :])

    def _beside(self, matrix: Floats) -> Floats:
        return np.column_stack([np.zeros((len(matrix), self.terms)), matrix])

    def _with_gains(self, columns: Floats) -> Floats:
        return np.concatenate([self._drive.gains / self.unit, columns])
