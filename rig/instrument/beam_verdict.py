"""The verdict on the beam, by its spots and its shape."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from acquisition.camera import Image
from processing.spot import BeamShape, FixedLight, Spot, SpotFlag, SpotModel, beam_shape
from rig.settings import PreflightSettings
from rig.terminal import Verdict, percent

NAME = "beam quality"
_MAX_DEPARTURE = 0.03
"""Fraction of the peak by which a beam may differ from a Gaussian without a remark."""
_MAX_MISSING_LIGHT = 0.1
"""Fraction of the peak that may be missing in the flank of a beam before the verdict is no-go."""
_MAX_FLANK_RATIO = 2.0
"""Largest ratio of the steepness of two opposite flanks."""
_MAX_CHI2 = 4.0
"""Chi2 per degree of freedom of a no-go: the tracker then doubles u, and a deviation that moves with the spot
costs more.
"""
_MAX_IMAGES = 16
_CLEAN_OPTICS = "clean laser window, lenses and mirrors; a spatial filter"
NO_STRAY_LIGHT = "block it, or tilt what reflects: window, filter, cover glass"
_MIDDLE_SIGMAS, _FLANK_SIGMAS = 0.5, 1.3
"""Distances from the centre within which the middle lies, and beyond which the flank lies."""


_fault = partial(Verdict, NAME)


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
    visible_spots = [spot for spot in spots if not spot.flags & SpotFlag.LOST]
    if not visible_spots:
        return Verdict(NAME, False, "there is nothing to judge", "find the spot first", measured="no spot")
    count = min(len(images), len(spots), _MAX_IMAGES)
    shape = beam_shape(images[len(images) - count :], spots[len(spots) - count :], full_scale_dn)
    # only spots fitted with the present model: before its choice another one was used
    learned_flag = visible_spots[-1].flags & SpotFlag.LEARNED
    model_spots = [spot for spot in visible_spots if spot.flags & SpotFlag.LEARNED == learned_flag]
    poor = float(np.mean([bool(spot.flags & SpotFlag.POOR_FIT) for spot in model_spots]))
    chi2 = float(np.median([spot.chi2_per_dof for spot in model_spots]))
    model_text = model or "one Gaussian so far"
    measured = f"{model_text}, χ²/dof {chi2:.2f}, POOR_FIT in {percent(poor, 3)} of frames"
    if shape is not None:
        measured += f", off a Gaussian by {percent(shape.departure)} of its peak"
    edge = float(np.mean([bool(spot.flags & SpotFlag.EDGE) for spot in visible_spots]))
    cut = float(np.mean([bool(spot.flags & SpotFlag.CUT) for spot in visible_spots]))
    is_cut = cut > limits.max_lost_fraction
    faults = [
        *_cuts(edge > limits.max_lost_fraction, is_cut, shape),
        *_bad_fit(poor > limits.max_poor_fit_fraction, chi2, model, noise_is_known=noise_is_known),
        *([] if is_cut else _other_shapes(shape)),
        *([] if light is None else [_fault(True, light.text, NO_STRAY_LIGHT)]),
    ]
    # the worst first; a fault of the shape is the likely cause of a bad fit
    faults.sort(key=lambda fault: fault.ok)
    return Verdict(
        NAME,
        all(fault.ok for fault in faults),
        "; ".join(fault.reason for fault in faults),
        "; ".join(dict.fromkeys(fault.remedy for fault in faults)),
        measured=measured,
        limit=f"POOR_FIT in {100 * limits.max_poor_fit_fraction:g} %, off by {100 * _MAX_DEPARTURE:g} %",
    )


def _cuts(at_edge: bool, is_cut: bool, shape: BeamShape | None) -> list[Verdict]:
    if at_edge:
        return [
            _fault(False, "the edge of the sensor cuts the spot", "move it to the middle: rig camera align")
        ]
    remedy = "centre the beam in lens, mirrors and window; free its path"
    if is_cut:
        if shape is None:
            return [_fault(False, "something cuts it", remedy)]
        reason = f"something cuts it: {percent(shape.departure)} of its peak are missing, at a sharp edge"
        return [_fault(shape.departure < _MAX_MISSING_LIGHT, reason, remedy)]
    if shape is None or _is_ghost(shape):
        return []
    if shape.lopsided > _MAX_FLANK_RATIO:
        reason = f"something cuts it: one side falls {shape.lopsided:.1f} times as steeply as the other"
        return [_fault(False, reason, remedy)]
    if not shape.extra_light and shape.away_sigmas > _FLANK_SIGMAS and shape.departure > _MAX_DEPARTURE:
        reason = f"something cuts it: {percent(shape.departure)} are missing {shape.away_px:.0f} px off"
        return [_fault(shape.departure < _MAX_MISSING_LIGHT, reason, remedy)]
    return []


def _bad_fit(poor: bool, chi2: float, model: SpotModel | None, *, noise_is_known: bool) -> list[Verdict]:
    if not poor:
        return []
    if model is None:
        reason = "one Gaussian does not fit; its own profile is learned from the first frames of the run"
        return [_fault(True, reason, _CLEAN_OPTICS)]
    if not noise_is_known:
        return [_fault(chi2 < _MAX_CHI2, "no model fits to the assumed noise", "rig calibrate sensor")]
    remedy = f"{_CLEAN_OPTICS}; let the laser warm up; rig calibrate sensor"
    return [_fault(chi2 < _MAX_CHI2, "no model fits", remedy)]


def _other_shapes(shape: BeamShape | None) -> list[Verdict]:
    if shape is None or shape.departure <= _MAX_DEPARTURE:
        return []
    departure = percent(shape.departure)
    if _is_ghost(shape):
        reason = f"a second spot or ghost: {departure} more light {shape.away_px:.0f} px off"
        return [_fault(True, reason, "tilt or wedge what reflects twice: window, filter, cover glass")]
    if not shape.extra_light and shape.away_sigmas > _FLANK_SIGMAS:
        return []
    if not shape.extra_light and shape.away_sigmas < _MIDDLE_SIGMAS:
        reason = f"hollow: {departure} of light are missing in its middle"
        return [_fault(True, reason, "one mode only: a spatial filter or fibre, clean lenses, less current")]
    return [_fault(True, f"ragged: {departure} off", _CLEAN_OPTICS)]


def _is_ghost(shape: BeamShape) -> bool:
    return shape.extra_light and shape.away_sigmas > _FLANK_SIGMAS
