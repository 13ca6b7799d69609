"""Live deflections and half-cycles less what a reference spot shows of the beam's motion.

For whoever watches a run: the record holds both spots as they were seen, and a fit of it takes off more, with
the whole run before it.
"""

from collections.abc import Callable, Sequence

import numpy as np

from processing.arrays import Floats, Ints
from processing.deflections import Deflections
from processing.estimate import Estimate
from processing.reference_spot import CausalReference
from processing.spot import Spot, SpotFlag
from processing.swing import Swing, SwingDetector
from processing.units import seconds
from rig.instrument.pipeline import BesideThread, Block, Deflector

_LOST_S = 0.5
"""Without the reference for longer, it is said; a fit goes by the same time."""
LESS_BEAM = (
    "the beam's motion, from the reference spot, is subtracted from live numbers but not in the record"
)


class LessBeam:
    """Takes blocks as the pipeline makes them and gives those that watchers are shown.

    `beside`: half-cycles are found in a thread of their own and come with a later block, as the pipeline's.
    """

    def __init__(self, deflector: Deflector, gain: Estimate, *, beside: bool) -> None:
        self._deflector = deflector
        self._reference = CausalReference(gain)
        self._detector = SwingDetector()
        self._beside = BesideThread(self._swings_in, "live swings") if beside else None
        self._detect: Callable[[Deflections], list[Swing]] = (
            self._swings_in if self._beside is None else self._beside.update
        )
        self._found_ns: int | None = None
        self._lost = False
        self._news: list[str] = [LESS_BEAM]

    def shown(self, frame_times_ns: Sequence[int], block: Block) -> Block:
        """The block with the beam's motion taken off, of frames at these times."""
        if not block.references:
            return block
        place, u = _table(block.references)
        moved, variance = self._reference.take(place, u)
        times_ns = np.array(frame_times_ns, dtype=np.int64)
        spots = [
            spot._replace(
                x_px=spot.x_px - x,
                y_px=spot.y_px - y,
                u_x_px=float(np.hypot(spot.u_x_px, u_x)),
                u_y_px=float(np.hypot(spot.u_y_px, u_y)),
            )
            for spot, (x, y), (u_x, u_y) in zip(
                block.spots, moved.tolist(), np.sqrt(variance).tolist(), strict=True
            )
        ]
        # when the rows were exposed on which the spot was seen
        deflections = self._deflector(times_ns, spots)
        deflections = Deflections(
            block.deflections.times_ns,
            deflections.x,
            deflections.y,
            deflections.u_x,
            deflections.u_y,
            deflections.unit,
        )
        self._watch(times_ns, np.isfinite(place[:, 0]).tolist())
        return block._replace(deflections=deflections, swings=self._detect(deflections))

    def finish(self) -> list[Swing]:
        """Half-cycles that are completed by the end of the frames."""
        waiting = [] if self._beside is None else self._beside.finish()
        return waiting + self._detector.finish()

    def take_news(self) -> list[str]:
        """What is to be said of it since the last call."""
        news, self._news = self._news, []
        return news

    def _swings_in(self, samples: Deflections) -> list[Swing]:
        return self._detector.update(samples.times_ns, samples.y, samples.u_y)

    def _watch(self, times_ns: Ints, found: Sequence[bool]) -> None:
        for time_ns, seen in zip(times_ns.tolist(), found, strict=True):
            if seen:
                if self._lost:
                    self._lost = False
                    self._news.append("reference spot found: live numbers exclude the beam's motion again")
                self._found_ns = time_ns
                continue
            if self._found_ns is None:
                self._found_ns = time_ns
            if not self._lost and seconds(time_ns - self._found_ns) > _LOST_S:
                self._lost = True
                self._news.append(
                    "reference spot lost: live numbers include the beam's motion until it is found again"
                )


def _table(references: Sequence[Spot]) -> tuple[Floats, Floats]:
    """Places and uncertainties (n, 2) in px; NaN where lost."""
    table = np.array([spot[:4] for spot in references], dtype=np.float64)
    table[[bool(spot.flags & SpotFlag.LOST) for spot in references]] = np.nan
    return table[:, :2], table[:, 2:]
