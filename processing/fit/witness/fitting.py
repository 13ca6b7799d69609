"""The exact fit with a witness of the ground: what it explains of the drive is taken off, where that pays.

A record that has nothing to do with the ground under the rig must not help. Gains are judged by half-cycles
that they were not fitted to: with those of an unrelated record the predictions of the others become worse.
"""

from dataclasses import dataclass, replace
from math import log
from typing import NamedTuple

import numpy as np

from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.exact import fit_exact
from processing.fit.result import FitResult
from processing.fit.witness.clock import Clock, clock_of, found_offset
from processing.fit.witness.signals import PAIR, SLOPES, Term, Witness
from processing.fit.witness.spectra import spectra_of
from processing.fit.witness.terms import Drives, Terms, gain_of_prediction, started
from processing.fit.witness.use import WitnessUse, WitnessVerdict, use_of
from processing.swing import TurningPoints

PAYS = 12.0
"""Fall of -2 ln L of half-cycles that gains were not fitted to, from which on they are used. With an
unrelated witness it rises, by about 2 for each gain."""
_FEWEST = 0.2
"""Share of the half-swings that the witness has to cover."""
_CORRECTIONS = 10
"""Most times that a clock is corrected; each brings it nearer by a tenth of a second or by half."""


@dataclass(frozen=True)
class Witnessed:
    """A fit with a witness; without it, where it was refused."""

    fit: FitResult
    use: WitnessUse


def fit_with_witness(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    witness: Witness,
    alone: FitResult,
    *,
    averaged: bool = True,
    offset_known: bool = True,
) -> Witnessed:
    """Fit the exact map with what a witness tells of the ground.

    Parameters
    ----------
    alone
        The exact fit of these points without a witness; it is returned where the witness does not pay.
    averaged
        As `fit_exact` has it.
    offset_known
        The times of the witness are on the clock of the points, up to a fraction of a period. False: where
        they explain nothing as they stand, an offset is sought.
    """
    search = _Search(points.first(alone.half_cycles), pendulum, alone, averaged)
    found = search.with_corrected_clock(witness, PAYS)
    if found.use.used or offset_known:
        return found
    try:
        offset = found_offset(search.points, pendulum, witness, alone, averaged=averaged)
    except DataError as error:
        return replace(found, use=replace(found.use, reason=str(error)))
    # the best of many is better than one by chance
    found = search.with_corrected_clock(witness.delayed(offset.by_s), PAYS + 2 * log(offset.tried))
    return replace(
        found,
        use=replace(found.use, offset_s=offset.by_s if found.use.used else 0.0, offsets_tried=offset.tried),
    )


class _Accepted(NamedTuple):
    """A fit with some terms, and by how much they made predictions better."""

    fit: FitResult
    chosen: Terms
    gain: float


@dataclass(frozen=True)
class _Search:
    points: TurningPoints
    pendulum: PendulumOnBall | None
    alone: FitResult
    averaged: bool

    def with_corrected_clock(self, witness: Witness, pays: float) -> Witnessed:
        """The fit with the witness, its clock corrected where the run shows it to be wrong.

        A slope of the phase is a delay. The clock is therefore corrected before slopes are fitted.
        """
        assert self.alone.ground is not None
        middle_s = 0.5 * float(self.points.time_s[0] + self.points.time_s[-1])
        delay_s = drift = 0.0
        for left in reversed(range(_CORRECTIONS + 1)):
            moved = witness.delayed(delay_s, drift, middle_s)
            try:
                drives = Drives(self.points, moved, averaged=self.averaged)
            except DataError as error:
                return Witnessed(self.alone, WitnessUse(verdict=WitnessVerdict.ABSENT, reason=str(error)))
            use = WitnessUse(
                missing_half_cycles=int(np.count_nonzero(drives.every.missing)),
                ground_alone_rad_per_s2_rthz=self.alone.ground.density_rad_per_s2_rthz,
            )
            count = len(drives.every.missing)
            if use.missing_half_cycles > (1 - _FEWEST) * count:
                reason = f"{use.missing_half_cycles} of {count} half-swings have no witness"
                return Witnessed(self.alone, replace(use, verdict=WitnessVerdict.ABSENT, reason=reason))
            found = self._with(drives, _Accepted(self.alone, [], 0.0), PAIR, pays)
            if not found.chosen:
                return Witnessed(self.alone, replace(use, gain_of_prediction=found.gain))
            clock = clock_of(self.points, self.pendulum, found.fit, drives, found.chosen)
            said = Clock(
                Estimate(delay_s + clock.delay_s.value, clock.delay_s.standard_uncertainty),
                Estimate(drift + clock.drift.value, clock.drift.standard_uncertainty),
            )
            if not left or not clock.wrong:
                break
            delay_s, drift = said.delay_s.value, said.drift.value
        found = self._with(drives, found, SLOPES, pays)
        use = replace(use, gain_of_prediction=found.gain, delay_s=said.delay_s, clock_drift=said.drift)
        use = use_of(use, self.alone, found.fit, drives.names, found.chosen)
        return Witnessed(found.fit, replace(use, spectra=spectra_of(self.points, self.pendulum, found.fit)))

    def _with(self, drives: Drives, accepted: _Accepted, kinds: tuple[Term, ...], pays: float) -> _Accepted:
        """With those components whose terms of these kinds pay as well, the best one first.

        Of slopes, those of components that are used. Where none is, the gain is that of the best.
        """
        used = sorted({component for component, _ in accepted.chosen})
        left = used if kinds is SLOPES else list(range(len(drives.names)))
        while left:
            gains = [self._gain(drives, accepted, component, kinds) for component in left]
            best = int(np.argmax(gains))
            if not gains[best] > pays:
                return accepted if accepted.chosen else accepted._replace(gain=gains[best])
            component = left.pop(best)
            chosen = [*accepted.chosen, *((component, kind) for kind in kinds)]
            fit = self.fitted_with(accepted.fit, drives, chosen)
            accepted = _Accepted(fit, chosen, accepted.gain + gains[best])
        return accepted

    def _gain(self, drives: Drives, accepted: _Accepted, component: int, kinds: tuple[Term, ...]) -> float:
        more = [(component, kind) for kind in kinds]
        return gain_of_prediction(self.points, self.pendulum, accepted.fit, drives, accepted.chosen, more)

    def fitted_with(self, near: FitResult, drives: Drives, chosen: Terms) -> FitResult:
        """The exact fit with some terms, sought from an earlier one with the first of them."""
        drive = started(drives, near, chosen)
        return fit_exact(
            self.points,
            self.pendulum,
            law=self.alone.law,
            drag=self.alone.has_drag,
            evidence=replace(self.alone.evidence, drive=drive),
            loss=self.alone.loss,
            averaged=self.averaged,
            near=near,
        )
