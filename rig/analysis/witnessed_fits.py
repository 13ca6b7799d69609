"""The exact fit of a decay with a witness of the ground, and what is said of it."""

from collections.abc import Callable
from dataclasses import replace
from math import isfinite, pi
from typing import NamedTuple

from processing.contact import PendulumOnBall
from processing.fit import PLACE, FitResult, Response, Witness, WitnessUse, fit_with_witness
from processing.swing import TurningPoints
from rig.analysis.recorded_witness import CLOCK_SET
from rig.analysis.witness_file import WitnessRecord
from rig.presentation import percent, plain, quantity, with_uncertainty

WitnessAt = Callable[[int], tuple[Witness, bool]]
"""A witness for a run whose first fitted turning point is at a time in ns, and whether its clock is known."""
_WELL = 1.05
"""Factor by which an uncertainty is smaller, from which on it is named."""


class WitnessedWith(NamedTuple):
    """A witness on the clock of a run's turning points, and whether that is known."""

    witness: Witness
    clock_known: bool

    def fit(
        self, points: TurningPoints, pendulum: PendulumOnBall, alone: FitResult
    ) -> tuple[FitResult, WitnessUse]:
        """The exact fit with the witness; the one without it where the witness does not pay."""
        found = fit_with_witness(points, pendulum, self.witness, alone, offset_known=self.clock_known)
        fit = found.fit.with_terms_of(alone, PLACE) if found.use.used else found.fit
        return fit, found.use


def of_source(use: WitnessUse | None, record: WitnessRecord | None) -> WitnessUse | None:
    """The same with where it came from, and what was read there."""
    if use is None or record is None:
        return use
    return replace(use, source=record.name, understood=record.understood)


def witness_sentences(use: WitnessUse) -> list[str]:
    """What a witness told, or why it was refused; and what was left out where it was read."""
    lost = [line for line in use.understood if line.startswith(("left out", "missing", CLOCK_SET))]
    return [*_told(use), *([f"Of the witness {use.source}: {'; '.join(lost)}."] if lost else [])]


def _told(use: WitnessUse) -> list[str]:
    if not use.used:
        gain = use.gain_of_prediction
        judged = f" (gain of prediction {gain:+.3g})" if isfinite(gain) else ""
        reason = f": {use.reason}" if use.reason else ""
        sought = f"; {use.offsets_tried} offsets of its clock were tried" if use.offsets_tried else ""
        said = f"Witness of the ground {use.verdict}{reason}{judged}{sought}."
        return [f"{said} The results are the same as without it."]
    before, left = use.ground_alone_rad_per_s2_rthz, use.ground_left_rad_per_s2_rthz
    explained = (
        f"it explains {percent(use.explained, 4)} of the drive at the pendulum's frequency, which falls from "
        f"{with_uncertainty(*before)} to {with_uncertainty(*left)} rad/s²/√Hz"
    )
    if use.spectra is not None and isfinite(use.spectra.coherence_near):
        explained += (
            f" (squared coherence within a tenth of it {use.spectra.coherence_near:.4g}, over "
            f"{use.spectra.stretches} stretches)"
        )
    responses = "; ".join(map(_response_text, use.responses))
    lines = [f"Witness of the ground: {explained}. Its response: {responses}."]
    saved = ", ".join(
        f"{plain(factor, 3)} ({quantity(name).symbol})"
        for name, factor in use.saved.items()
        if factor > _WELL
    )
    if saved:
        lines.append(f"The witness reduces the uncertainties by factors of {saved}.")
    found = f"{use.offset_s:+.5g} s, the best of {use.offsets_tried}, and " if use.offsets_tried else ""
    lines.append(
        f"Clock of the witness: {found}{with_uncertainty(*use.delay_s)} s to be added to its times, drift "
        f"{with_uncertainty(*use.clock_drift)} s/s."
    )
    if use.missing_half_cycles:
        lines.append(
            f"{use.missing_half_cycles} half-swings have no witness; their drive is treated as unknown."
        )
    return lines


def _response_text(response: Response) -> str:
    degrees = 180 / pi
    slope = ", changing within the band" if response.with_slope else ""
    return (
        f"{response.name} {with_uncertainty(response.gain, response.u_gain)} rad/s² per unit at "
        f"{with_uncertainty(degrees * response.phase_rad, degrees * response.u_phase_rad)}°{slope}"
    )
