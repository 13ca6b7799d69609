"""The frames that a preflight looks at."""

from collections.abc import Sequence
from dataclasses import dataclass

from acquisition.frame import Frame
from processing.deflections import Deflections
from processing.spot import Spot, SpotModel


@dataclass(frozen=True, slots=True)
class TrialFrames:
    """Some seconds of frames, with the spots and deflections measured in them.

    `resting` is False if the pendulum may be swinging. `model` is what the tracker has chosen for the beam;
    None while it has not. `references` are the reference's spots, where the frames have one.
    """

    frames: Sequence[Frame]
    spots: Sequence[Spot]
    deflections: Deflections
    resting: bool
    model: SpotModel | None = None
    references: Sequence[Spot] = ()
