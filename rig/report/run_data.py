"""What a report is made of: runs with their results and what only the records hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.frame import Frame
from processing.swing import ResidualSpectrum, TurningPoints
from rig.analysis import RunResults, Series, StoredTurningPoints, TableDecay

Array = NDArray[np.float64]


class ShownUnit(NamedTuple):
    """The unit in which deflections are shown, and its size in that in which they are stored."""

    shown: str
    shown_size: float


@dataclass(frozen=True)
class ShownTrajectory:
    """Deflection of every frame as shown, so in `unit.shown`; NaN where the spot was lost."""

    time_s: Array
    x: Array
    y: Array
    unit: ShownUnit


@dataclass(frozen=True)
class RecordedPicture:
    """One whole frame and the spot that was found in it."""

    frame: Frame
    x_px: float
    y_px: float
    sigma_px: float


@dataclass(frozen=True)
class RunData:
    """One run: its results, the turning points that were fitted, its motion.

    `motion` counts time from the first turning point, as `stored` does. `provenance` is text by section
    and key. `spectrum`, of what the samples hold besides the swing, is None for runs too short for one.
    """

    title: str
    results: RunResults
    stored: StoredTurningPoints
    motion: ShownTrajectory
    picture: RecordedPicture | None
    provenance: Mapping[str, Mapping[str, str]]
    spectrum: ResidualSpectrum | None = None
    notes: Sequence[str] = ()

    @property
    def simulated(self) -> bool:
        """Whether the frames are those of the simulated rig."""
        return bool(self.results.simulated)

    @property
    def of_table(self) -> bool:
        """Whether it is a decay of a table or a film, which knows nothing of frames and cameras."""
        return isinstance(self.results, TableDecay)

    @property
    def points(self) -> TurningPoints:
        """The turning points as the fits took them."""
        return self.stored.points()


@dataclass(frozen=True)
class ReportSource:
    """A session: its runs and their series, None where they make none.

    `results` are the name and the SHA-256 of the file that was read.
    """

    folder: Path
    results: tuple[str, str]
    series: Series | None
    runs: Sequence[RunData]
