"""What a witness of the ground revealed about a run, as stored in the results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import atan2, hypot, nan
from typing import Annotated

import numpy as np

from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit.result import FitResult
from processing.fit.witness.signals import Term
from processing.fit.witness.spectra import WitnessSpectra
from processing.quantity import Quantity


class WitnessVerdict(StrEnum):
    """Whether a witness was used."""

    USED = "used"
    NO_GAIN = "refused: it explains nothing of the pendulum's motion"
    ABSENT = "refused: it does not cover the run"


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Response of the pendulum's angular acceleration to one component of a witness, at its frequency.

    `gain` is in rad/s^2 per unit of the witness; `phase_rad` is the lead of the drive over it, with
    deflections positive at the first turning point.
    """

    name: str
    gain: float = nan
    u_gain: float = nan
    phase_rad: float = nan
    u_phase_rad: float = nan
    with_slope: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class WitnessUse:
    """What a witness of the ground revealed about a run.

    Attributes
    ----------
    source, understood
        Name of its file, or its place in the record; what was read of it, and what was left out.
    gain_of_prediction
        Decrease of -2 ln L of half-cycles with gains fitted to the others.
    explained
        Share of the drive's power at the pendulum's frequency that it explains: the squared coherence.
    ground_alone, ground_left
        Densities of the drive without the witness, and of the remainder, rad/s^2/sqrt(Hz).
    missing_half_cycles
        Half-swings without a witness; the drive is unknown in them.
    offset_s, offsets_tried
        Offset added to the witness's times if it was searched for, and the number of offsets tried.
    delay_s, clock_drift
        Further correction of these times, in s and in s per second from the middle of the run, as the run
        shows it; it was applied if it exceeds four standard uncertainties.
    saved
        Factor by which the uncertainty of each parameter is smaller.
    spectra
        Of the drive before and after, and its coherence with the witness's prediction.
    """

    source: str = ""
    understood: tuple[str, ...] = ()
    verdict: WitnessVerdict = WitnessVerdict.NO_GAIN
    reason: str = ""
    gain_of_prediction: Annotated[float, Quantity("", "gain of prediction")] = nan
    explained: Annotated[float, Quantity("", "share of the drive explained", "%")] = nan
    ground_alone_rad_per_s2_rthz: Estimate = NOT_DETERMINED
    ground_left_rad_per_s2_rthz: Estimate = NOT_DETERMINED
    responses: tuple[Response, ...] = ()
    missing_half_cycles: int = 0
    offset_s: float = 0.0
    offsets_tried: int = 0
    delay_s: Estimate = NOT_DETERMINED
    clock_drift: Estimate = NOT_DETERMINED
    saved: Mapping[str, float] = field(default_factory=dict)
    spectra: WitnessSpectra | None = None

    @property
    def used(self) -> bool:
        return self.verdict is WitnessVerdict.USED

    def beside(self, alone: FitResult, fit: FitResult) -> "WitnessUse":
        """The same with what the witness saved of a fit's uncertainties, beside those of one without it."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = alone.standard_uncertainty / fit.standard_uncertainty
        saved = dict(zip(fit.names, ratio.tolist(), strict=True))
        return replace(self, saved={name: saved[name] for name in fit.contact_names})


def use_of(
    use: WitnessUse,
    alone: FitResult,
    fit: FitResult,
    names: Sequence[str],
    chosen: Sequence[tuple[int, Term]],
) -> WitnessUse:
    """With what an accepted fit says; `names` are those of the components."""
    assert alone.ground is not None
    assert fit.ground is not None
    drive = fit.evidence.drive
    assert drive is not None
    assert drive.covariance is not None
    responses = []
    for component in sorted({component for component, _ in chosen}):
        first = list(chosen).index((component, Term.GAIN))
        a, b = drive.gains[first], -drive.gains[first + 1]
        gain = hypot(a, b)
        covariance = drive.covariance[first : first + 2, first : first + 2] * np.array([[1, -1], [-1, 1]])
        along, across = np.array([a, b]) / gain, np.array([-b, a]) / gain
        responses.append(
            Response(
                name=names[component],
                gain=gain,
                u_gain=float(np.sqrt(along @ covariance @ along)),
                phase_rad=atan2(b, a),
                u_phase_rad=float(np.sqrt(across @ covariance @ across)) / gain,
                with_slope=(component, Term.SLOPE) in chosen,
            )
        )
    left = fit.ground.density_rad_per_s2_rthz
    known = float(np.mean((drive.steps[0][~drive.missing] @ drive.gains) ** 2))
    step = fit.ground.noise.step
    return replace(
        use.beside(alone, fit),
        verdict=WitnessVerdict.USED,
        explained=float(known / (known + step**2)),
        ground_left_rad_per_s2_rthz=left,
        responses=tuple(responses),
    )
