"""Events of a run whose rest position or background light has stepped, or whose swing was pushed."""

import math

import numpy as np

from acquisition.record.events import Event, EventKind
from processing.deflections import DeflectionUnit
from processing.spot import SpotFlag
from processing.step_watch import KickWatch, StepWatch
from rig.instrument import Block

_LEAST_REST = {DeflectionUnit.RAD: 3.0, DeflectionUnit.PX: 1.0}
"""In arcsec, and in px without a lever: far above drift within some half-cycles."""
_LEAST_PUSH = {DeflectionUnit.RAD: 1.0, DeflectionUnit.PX: 2.0}
_LEAST_LIGHT_DN = 1.0


class StepEvents:
    """Takes the blocks of a run; one value a half-cycle is compared, so that the swing itself cancels."""

    def __init__(self, unit: DeflectionUnit) -> None:
        self._unit = unit
        self._rest = StepWatch(_LEAST_REST[unit])
        self._push = KickWatch(_LEAST_PUSH[unit])
        self._light = StepWatch(_LEAST_LIGHT_DN)
        self._background_dn: list[float] = []

    def take(self, block: Block) -> list[Event]:
        """Steps that were noticed with this block."""
        found: list[Event] = []
        lost = SpotFlag.LOST
        self._background_dn += [spot.background_dn for spot in block.spots if not spot.flags & lost]
        for swing in block.swings:
            rest = math.nan if swing.flags else swing.centre / self._unit.shown_size
            step = self._rest.take(swing.turn_time_ns, rest)
            if step is not None:
                text = f"the rest position moved by {step.size:+.1f} {self._unit.shown}"
                found.append(Event(step.time_ns, EventKind.REST_STEP, text))
            amplitude = math.nan if swing.flags else swing.amplitude / self._unit.shown_size
            kick = self._push.take(swing.index, swing.turn_time_ns, amplitude)
            if kick is not None:
                text = f"the swing was pushed by {kick.size:.1f} {self._unit.shown}: a draught, or a knock"
                found.append(Event(kick.time_ns, EventKind.PUSH, text))
            light_dn = float(np.median(self._background_dn)) if self._background_dn else math.nan
            self._background_dn.clear()
            step = self._light.take(swing.turn_time_ns, light_dn)
            if step is not None:
                text = f"the background moved by {step.size:+.1f} DN"
                found.append(Event(step.time_ns, EventKind.LIGHT_STEP, text))
        return found
