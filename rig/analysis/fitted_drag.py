"""How a run's fits treat the drag of the air: left free, about what is known of it, or absent."""

from typing import NamedTuple

from processing.contact import ExpectedDrag, PendulumOnBall
from processing.estimate import Estimate
from processing.fit import Evidence, waveform_of
from processing.surroundings import Surroundings
from processing.swing import SwingHarmonics
from rig.analysis.surroundings import expected_drag
from rig.settings import Configuration

_DOUBT, _DOUBT_OF_STATED = 0.75, 0.3
"""Relative standard uncertainty of the drag of a bar in the pendulum's place: a factor of two up or down, and
what ends, mirror and weights may do where length and width are stated."""
_GEOMETRY = frozenset({"length_m", "width_m"})


class FittedDrag(NamedTuple):
    """Whether a drag is fitted, and what is known of it beside the run; None: nothing."""

    fitted: bool = True
    known_s: Estimate | None = None


OPEN_DRAG = FittedDrag()


def known_drag(
    config: Configuration, air: Surroundings, pendulum: PendulumOnBall, period_s: float
) -> tuple[FittedDrag, ExpectedDrag]:
    """As [fit] has it, and what the air is expected to exert."""
    of_air, settings = expected_drag(air, pendulum, period_s, config), config.fit
    if settings.drag == "vacuum":
        return FittedDrag(fitted=False), of_air
    if settings.drag == "open":
        return FittedDrag(), of_air
    if settings.drag_s is not None:
        return FittedDrag(known_s=Estimate(settings.drag_s, settings.u_drag_s)), of_air
    doubt = _DOUBT if _GEOMETRY & set(of_air.assumed) else _DOUBT_OF_STATED
    return FittedDrag(known_s=Estimate(of_air.drag_s, doubt * of_air.drag_s)), of_air


def evidence_of(drag: FittedDrag, harmonics: SwingHarmonics | None) -> Evidence:
    """What restrains the fit of a run beside its turning points."""
    waveform = None if harmonics is None else waveform_of(harmonics)
    return Evidence(waveform, drag.known_s)
