"""The fits of a decay with a witness of the ground, and what is said of it."""

from collections.abc import Callable
from dataclasses import replace
from math import pi

from processing.contact import PendulumOnBall
from processing.fit import FitMethod, Response, Witness, WitnessUse, fit_with_witness, with_place_errors
from processing.swing import TurningPoints
from rig.analysis.contact_laws import DecayFits, surface_energies
from rig.presentation import plain, quantity, with_uncertainty

WitnessAt = Callable[[int], tuple[Witness, bool]]
"""A witness for a run whose first fitted turning point is at a time in ns, and whether its clock is known."""
_WELL = 1.05
"""Factor by which an uncertainty is smaller, from which on it is named."""


def with_witness(
    decay: DecayFits, points: TurningPoints, pendulum: PendulumOnBall, witness: Witness, *, clock_known: bool
) -> tuple[DecayFits, WitnessUse]:
    """The fits with the exact one as a witness makes it; Eqs. 5 and 6 keep the paper's procedure."""
    alone = decay.fits[FitMethod.EXACT]
    found = fit_with_witness(points, pendulum, witness, alone, offset_known=clock_known)
    if not found.use.used:
        return decay, found.use
    exact = found.fit
    if alone.place_covariance is not None:
        exact = with_place_errors(exact, alone.place_covariance, alone.names)
    fits = {**decay.fits, FitMethod.EXACT: exact}
    return replace(decay, fits=fits, surface_energy=surface_energies(fits, pendulum)), found.use


def witness_sentences(use: WitnessUse) -> list[str]:
    """What a witness told, or why it was refused."""
    if not use.used:
        gain = use.gain_of_prediction
        judged = (
            f" (predictions of half-cycles it was not fitted to: {gain:+.3g} in −2 ln L)"
            if gain == gain
            else ""
        )
        reason = f": {use.reason}" if use.reason else ""
        sought = f"; {use.offsets_tried} offsets of its clock were tried" if use.offsets_tried else ""
        return [f"Witness of the ground {use.verdict}{reason}{judged}{sought}. All stands as without it."]
    before, left = use.ground_alone_rad_per_s2_rthz, use.ground_left_rad_per_s2_rthz
    explained = (
        f"it explains {100 * use.explained:.4g} % of the drive at the pendulum's frequency, which falls from "
        f"{with_uncertainty(*before)} to {with_uncertainty(*left)} rad/s²/√Hz"
    )
    responses = "; ".join(map(_response_text, use.responses))
    lines = [f"Witness of the ground: {explained}. Its response: {responses}."]
    saved = ", ".join(
        f"{quantity(name).symbol} {plain(factor, 3)}" for name, factor in use.saved.items() if factor > _WELL
    )
    if saved:
        lines.append(f"With the witness uncertainties are smaller by factors of {saved}.")
    found = f"{use.offset_s:+.5g} s, the best of {use.offsets_tried}, and " if use.offsets_tried else ""
    lines.append(
        f"Clock of the witness: {found}{with_uncertainty(*use.delay_s)} s to be added to its times, drift "
        f"{with_uncertainty(*use.clock_drift)} s/s."
    )
    if use.missing_half_cycles:
        lines.append(f"{use.missing_half_cycles} half-swings have no witness; their drive is unknown.")
    return lines


def _response_text(response: Response) -> str:
    degrees = 180 / pi
    slope = ", changing within the band" if response.with_slope else ""
    return (
        f"{response.name} {with_uncertainty(response.gain, response.u_gain)} rad/s² a unit at "
        f"{with_uncertainty(degrees * response.phase_rad, degrees * response.u_phase_rad)}°{slope}"
    )
