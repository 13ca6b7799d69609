"""The verdict on the beam by its spots and its shape, and the live correction of the beam's motion."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from acquisition.camera import Image
from processing.arrays import Floats, Ints
from processing.deflections import Deflections
from processing.estimate import Estimate
from processing.reference_spot import CausalReference
from processing.spot import BeamShape, FixedLight, Spot, SpotFlag, SpotModel, beam_shape
from processing.swing import HalfCycle, TurningPointDetector
from processing.units import seconds
from rig.instrument.pipeline import Block, DeflectionConverter
from rig.settings import PreflightSettings
from rig.terminal import Verdict, percent

NAME = "beam quality"
_MAX_DEPARTURE = 0.03
"""Fraction of the peak by which a beam may differ from a Gaussian without a remark."""
_MAX_CUT = 0.1
"""Fraction of the peak that may be missing in the flank of a beam before the verdict is no-go."""
_MAX_LOPSIDED = 2.0
_MAX_CHI2 = 4.0
"""Chi2 per degree of freedom of a no-go: u is doubled then, and one that moves with the spot is worse."""
_MAX_PICTURES = 16
_CLEAN = "clean laser window, lenses and mirrors; a spatial filter"
NO_STRAY_LIGHT = "block it, or tilt what reflects: window, filter, cover glass"
_MIDDLE_SIGMAS, _FLANK_SIGMAS = 0.5, 1.3


class _Fault(NamedTuple):
    ok: bool
    reason: str
    remedy: str


def beam_quality(
    images: Sequence[Image],
    spots: Sequence[Spot],
    model: SpotModel | None,
    full_scale_dn: float,
    limits: PreflightSettings,
    *,
    noise_is_known: bool = True,
    light: FixedLight | None = None,
) -> Verdict:
    """The verdict on the beam: go, caution (a reason, but ok) or no-go.

    Parameters
    ----------
    images
        The newest whole frames; the last of them belongs to the last of `spots`.
    spots
        Spots of consecutive frames, at rest or in motion.
    model
        The tracker's model of the beam; None before it is chosen.
    noise_is_known
        Whether the sensor's noise is stated, not assumed.
    light
        Light that stays in place while the spot moves past it.
    """
    found = [spot for spot in spots if not spot.flags & SpotFlag.LOST]
    if not found:
        return Verdict(NAME, False, "there is nothing to judge", "find the spot first", measured="no spot")
    count = min(len(images), len(spots), _MAX_PICTURES)
    shape = beam_shape(images[len(images) - count :], spots[len(spots) - count :], full_scale_dn)
    # only spots fitted with the present model: before its choice another one was used
    learned = found[-1].flags & SpotFlag.LEARNED
    same = [spot for spot in found if spot.flags & SpotFlag.LEARNED == learned]
    poor = float(np.mean([bool(spot.flags & SpotFlag.POOR_FIT) for spot in same]))
    chi2 = float(np.median([spot.chi2_per_dof for spot in same]))
    words = f"{model or 'one Gaussian so far'}, χ²/dof {chi2:.2f}, POOR_FIT in {percent(poor, 3)} of frames"
    if shape is not None:
        words += f", off a Gaussian by {percent(shape.departure)} of its peak"
    edge = float(np.mean([bool(spot.flags & SpotFlag.EDGE) for spot in found]))
    cut = float(np.mean([bool(spot.flags & SpotFlag.CUT) for spot in found]))
    is_cut = cut > limits.max_lost_fraction
    faults = [
        *_cuts(edge > limits.max_lost_fraction, is_cut, shape),
        *_bad_fit(poor > limits.max_poor_fit_fraction, chi2, model, noise_is_known=noise_is_known),
        *([] if is_cut else _other_shapes(shape)),
        *([] if light is None else [_Fault(True, light.text, NO_STRAY_LIGHT)]),
    ]
    # the worst first; a fault of the shape is the likely cause of a bad fit
    faults.sort(key=lambda fault: fault.ok)
    return Verdict(
        NAME,
        all(fault.ok for fault in faults),
        "; ".join(fault.reason for fault in faults),
        "; ".join(dict.fromkeys(fault.remedy for fault in faults)),
        measured=words,
        limit=f"POOR_FIT in {100 * limits.max_poor_fit_fraction:g} %, off by {100 * _MAX_DEPARTURE:g} %",
    )


def _cuts(at_edge: bool, is_cut: bool, shape: BeamShape | None) -> list[_Fault]:
    if at_edge:
        return [
            _Fault(False, "the edge of the sensor cuts the spot", "move it to the middle: rig camera align")
        ]
    free = "centre the beam in lens, mirrors and window; free its path"
    if is_cut:
        if shape is None:
            return [_Fault(False, "something cuts it", free)]
        reason = f"something cuts it: {percent(shape.departure)} of its peak are missing, at a sharp edge"
        return [_Fault(shape.departure < _MAX_CUT, reason, free)]
    if shape is None or _is_ghost(shape):
        return []
    if shape.lopsided > _MAX_LOPSIDED:
        reason = f"something cuts it: one side falls {shape.lopsided:.1f} times as steeply as the other"
        return [_Fault(False, reason, free)]
    if not shape.extra_light and shape.away_sigmas > _FLANK_SIGMAS and shape.departure > _MAX_DEPARTURE:
        reason = f"something cuts it: {percent(shape.departure)} are missing {shape.away_px:.0f} px off"
        return [_Fault(shape.departure < _MAX_CUT, reason, free)]
    return []


def _bad_fit(poor: bool, chi2: float, model: SpotModel | None, *, noise_is_known: bool) -> list[_Fault]:
    if not poor:
        return []
    if model is None:
        reason = "one Gaussian does not fit; its own profile is learned from the first frames of the run"
        return [_Fault(True, reason, _CLEAN)]
    if not noise_is_known:
        return [_Fault(chi2 < _MAX_CHI2, "no model fits to the assumed noise", "rig calibrate sensor")]
    remedy = f"{_CLEAN}; let the laser warm up; rig calibrate sensor"
    return [_Fault(chi2 < _MAX_CHI2, "no model fits", remedy)]


def _other_shapes(shape: BeamShape | None) -> list[_Fault]:
    if shape is None or shape.departure <= _MAX_DEPARTURE:
        return []
    part = percent(shape.departure)
    if _is_ghost(shape):
        reason = f"a second spot or ghost: {part} more light {shape.away_px:.0f} px off"
        return [_Fault(True, reason, "tilt or wedge what reflects twice: window, filter, cover glass")]
    if not shape.extra_light and shape.away_sigmas > _FLANK_SIGMAS:
        return []
    if not shape.extra_light and shape.away_sigmas < _MIDDLE_SIGMAS:
        reason = f"hollow: {part} of light are missing in its middle"
        return [_Fault(True, reason, "one mode only: a spatial filter or fibre, clean lenses, less current")]
    return [_Fault(True, f"ragged: {part} off", _CLEAN)]


def _is_ghost(shape: BeamShape) -> bool:
    return shape.extra_light and shape.away_sigmas > _FLANK_SIGMAS


_MIN_LOST_S = 0.5
"""Shortest loss of the reference spot that is reported; the fit uses the same time."""
BEAM_CORRECTED = (
    "the beam's motion, from the reference spot, is subtracted from live numbers but not in the record"
)


class BeamCorrection:
    """Subtracts the beam's motion, which the reference spot shows, from the blocks of the pipeline."""

    def __init__(self, deflector: DeflectionConverter, gain: Estimate) -> None:
        self._deflector = deflector
        self._reference = CausalReference(gain)
        self._detector = TurningPointDetector()
        self._found_ns: int | None = None
        self._lost = False
        self._news: list[str] = [BEAM_CORRECTED]

    def shown(self, frame_times_ns: Sequence[int], block: Block) -> Block:
        """The block with the beam's motion subtracted; `frame_times_ns` are the times of its frames."""
        if not block.references:
            return block
        position_px, u_px = _table(block.references)
        moved, variance = self._reference.take(position_px, u_px)
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
        # keep the times of exposure of the rows on which the spot was seen
        deflections = self._deflector(times_ns, spots)
        deflections = Deflections(
            block.deflections.times_ns,
            deflections.x,
            deflections.y,
            deflections.u_x,
            deflections.u_y,
            deflections.unit,
        )
        self._watch(times_ns, np.isfinite(position_px[:, 0]).tolist())
        swings = self._detector.update(deflections.times_ns, deflections.y, deflections.u_y)
        return block._replace(deflections=deflections, swings=swings)

    def finish(self) -> list[HalfCycle]:
        """Half-cycles that are completed by the end of the frames."""
        return self._detector.finish()

    def take_news(self) -> list[str]:
        """Texts for the log since the last call."""
        news, self._news = self._news, []
        return news

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
            if not self._lost and seconds(time_ns - self._found_ns) > _MIN_LOST_S:
                self._lost = True
                self._news.append(
                    "reference spot lost: live numbers include the beam's motion until it is found again"
                )


def _table(references: Sequence[Spot]) -> tuple[Floats, Floats]:
    """Positions and standard uncertainties (n, 2) in px; NaN where the spot is lost."""
    table = np.array([spot[:4] for spot in references], dtype=np.float64)
    table[[bool(spot.flags & SpotFlag.LOST) for spot in references]] = np.nan
    return table[:, :2], table[:, 2:]
