"""A frame during the alignment of the camera: its spot, its figures, the verdicts on them, its picture."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.camera import CameraSettings, Frame, Image
from calibration import Lever
from processing.spot import Spot, SpotFlag
from rig.devices import picture
from rig.devices.picture import PictureFigures
from rig.instrument import Pipeline, beam_quality, reference_px
from rig.settings import PreflightSettings
from rig.terminal import Verdict, decimals, palette

_MAX_CENTRE_DISTANCE = 0.1
"""Largest distance of a centred spot from the crosshair, over the frame's shorter side."""
_MIN_EDGE_DISTANCE = 0.15
"""Distance from all edges, over the frame's shorter side, from which a spot off the centre may swing."""
_LESS_LIGHT = "expose shorter, or less gain"
_OFF_CENTRE_REMEDY = "at rest it belongs to the crosshair; a swing passes there"
_MIN_SHARPNESS_RATIO = 0.95
"""Smallest ratio of the sharpness of a good focus to the best so far."""


class ReferenceSpot(NamedTuple):
    """The spot in the reference's part of a frame."""

    spot: Spot
    """Spot in px of the whole frame; its fields are NaN if none was found."""
    from_row_px: int
    """First row of the reference's part."""
    saturated_px: int
    """Number of saturated pixels there."""

    @classmethod
    def in_image(cls, spot: Spot, from_row_px: int, image: Image, full_scale_dn: int) -> "ReferenceSpot":
        """The spot of an image whose part from a row on is the reference's."""
        return cls(spot, from_row_px, int(np.count_nonzero(image[from_row_px:] >= full_scale_dn)))

    @property
    def has_spot(self) -> bool:
        """Whether there is a spot."""
        return not self.spot.flags & SpotFlag.LOST

    @property
    def lamp(self) -> Verdict:
        """Verdict on the reference, with the remedy if its spot cannot be followed."""
        if not self.has_spot:
            remedy = f"let the reference's beam fall below row {self.from_row_px}"
            return Verdict("reference", False, remedy=remedy, measured="none found", limit="one spot")
        reason = remedy = ""
        if self.saturated_px:
            reason, remedy = f"{self.saturated_px} px are saturated", "weaken the reference's beam"
        elif self.spot.flags & (SpotFlag.EDGE | SpotFlag.CUT):
            reason, remedy = "it is cut by the edge of its part", "move it to the middle of its part"
        measured = f"{self.spot.x_px:.1f}, {self.spot.y_px:.1f} px"
        return Verdict("reference", not reason, reason, remedy, measured=measured, limit="one whole spot")


class AlignmentFrame(NamedTuple):
    """A frame (ny, nx) in DN for display, with the spot, its figures and the verdicts on them."""

    image: Image
    full_scale_dn: int
    figures: PictureFigures
    spot: Spot
    """Fitted spot; its fields are NaN if none was found."""
    crosshair_px: tuple[float, float]
    """Position (x, y) at which the spot should rest: the light lever's reference, else the middle of the
    pendulum's part of the frame."""
    applied: CameraSettings
    """Settings that the camera has read back."""
    beam: Verdict | None = None
    """The verdict on the beam; None where it was not judged."""
    reference: ReferenceSpot | None = None
    """The reference's spot, in the frame's px; None without a reference, or where it was not searched for."""
    limits: PreflightSettings = PreflightSettings()
    """Limits of the peak."""

    @property
    def has_spot(self) -> bool:
        """Whether there is a spot."""
        return not self.spot.flags & SpotFlag.LOST

    def lamps(self, sharpest_per_px: float = 0.0) -> list[Verdict]:
        """Verdicts, with remedies, on peak, saturation, centring, focus, beam and reference.

        `sharpest_per_px` is the best sharpness so far, with which the focus is compared.
        """
        figures, low, high = self.figures, self.limits.min_peak_fraction, self.limits.max_peak_fraction
        peak_ok = low <= figures.peak <= high
        lamps = [
            Verdict(
                "peak",
                peak_ok,
                remedy="" if peak_ok else "expose longer" if figures.peak < low else "expose shorter",
                measured=f"{100 * figures.peak:.0f} %",
                limit=f"{100 * low:.0f} to {100 * high:.0f} %",
            ),
            Verdict(
                "saturated",
                not figures.saturated_px,
                remedy=_LESS_LIGHT if figures.saturated_px else "",
                measured=f"{figures.saturated_px} px" if figures.saturated_px else "none",
                limit="none",
            ),
        ]
        reference = [] if self.reference is None else [self.reference.lamp]
        if not self.has_spot:
            remedy = "let the beam fall on the sensor"
            return [*lamps, Verdict("spot", False, remedy=remedy, measured="none found"), *reference]
        off_px, shortest_px = max(map(abs, self._off_px)), min(self._pendulum_shape)
        centred = off_px <= _MAX_CENTRE_DISTANCE * shortest_px
        may_swing = centred or self._edge_px >= _MIN_EDGE_DISTANCE * shortest_px
        lamps.append(
            Verdict(
                "centring",
                True,
                remedy="" if may_swing else _OFF_CENTRE_REMEDY,
                measured=f"{_offset(self._off_px, 0)} px",
                limit=f"{_MAX_CENTRE_DISTANCE * shortest_px:.0f} px",
            )
        )
        is_sharp = figures.sharpness_per_px >= _MIN_SHARPNESS_RATIO * sharpest_per_px
        focus_remedy = "" if is_sharp else f"was {sharpest_per_px:.4f} /px: turn the focus back"
        measured = f"{figures.sharpness_per_px:.4f} /px"
        lamps.append(Verdict("focus", True, remedy=focus_remedy, measured=measured, limit="the best so far"))
        return [*lamps, *([] if self.beam is None else [self.beam]), *reference]

    def rows(self) -> list[tuple[str, str]]:
        """The figures as rows of (name, text); those of the spot only if there is one."""
        figures, spot, applied = self.figures, self.spot, self.applied
        height_px, width_px = self.image.shape
        exposure, gain = applied.exposure_us, applied.gain_db
        rows = [
            ("peak", f"{100 * figures.peak:.1f} %, background {100 * figures.background:.1f} %"),
            ("saturated", f"{figures.saturated_px} px" if figures.saturated_px else "none"),
            ("sharpness", f"{figures.sharpness_per_px:.4f} /px"),
        ]
        if self.has_spot:
            sigmas_px = spot.sigma_x_px, spot.sigma_y_px
            shape = f"ellipticity {max(sigmas_px) / min(sigmas_px):.2f}"
            flags = [
                flag.name.lower().replace("_", " ") for flag in SpotFlag if spot.flags & flag and flag.name
            ]
            rows += [
                ("spot", f"{spot.x_px:.2f}, {spot.y_px:.2f} px"),
                ("off the crosshair", f"{_offset(self._off_px, 1)} px"),
                ("nearest edge", f"{self._edge_px:.0f} px"),
                ("sigma", f"{spot.sigma_x_px:.2f} × {spot.sigma_y_px:.2f} px, {shape}"),
                ("fit", f"χ²/dof {spot.chi2_per_dof:.2f}, {', '.join(flags) or 'a clean spot'}"),
            ]
        else:
            rows.append(("spot", "none found"))
        if self.reference is not None:
            rows.append(("reference", self.reference.lamp.measured))
        offset_px = (applied.offset_x_px, applied.offset_y_px)
        origin = "" if None in offset_px else f" from ({offset_px[0]}, {offset_px[1]})"
        exposure_text = "unknown" if exposure is None else f"{exposure:.6g} µs"
        rows += [
            ("region", f"{width_px} × {height_px} px{origin}"),
            ("exposure", f"{exposure_text}, gain {'unknown' if gain is None else f'{gain:.3g} dB'}"),
        ]
        return rows if self.beam is None else [*rows, ("beam", self.beam.judgement_text)]

    @property
    def _off_px(self) -> tuple[float, float]:
        return self.spot.x_px - self.crosshair_px[0], self.spot.y_px - self.crosshair_px[1]

    @property
    def _pendulum_shape(self) -> tuple[int, int]:
        """Rows and columns of the pendulum's part of the frame."""
        rows, columns = self.image.shape
        return rows if self.reference is None else self.reference.from_row_px, columns

    @property
    def _edge_px(self) -> float:
        height_px, width_px = self._pendulum_shape
        spot = self.spot
        return float(min(spot.x_px, spot.y_px, width_px - 1 - spot.x_px, height_px - 1 - spot.y_px))


def _offset(off_px: tuple[float, float], digits: int) -> str:
    return ", ".join(decimals(value, digits, sign=True) for value in off_px)


def take_look(
    frame: Frame,
    full_scale_dn: int,
    pipeline: Pipeline,
    lever: Lever | None,
    applied: CameraSettings,
    limits: PreflightSettings,
) -> AlignmentFrame:
    """The spot of a frame, with verdicts on frame and beam by the preflight's limits.

    Figures and beam are those of the pendulum's part of the frame.
    """
    block, image = pipeline.process([frame], estimated=False), frame.image
    first_row = pipeline.reference_row
    pendulum_image, spot, reference = image[:first_row], block.spots[0], None
    if first_row is not None and block.references:
        reference = ReferenceSpot.in_image(block.references[0], first_row, image, full_scale_dn)
    beam = beam_quality([pendulum_image], [spot], pipeline.tracker.model, full_scale_dn, limits)
    figures = picture.figures(pendulum_image, full_scale_dn)
    if beam.ok and figures.saturated_px:
        # the shape of a beam that is cut off at full scale cannot be judged
        beam = replace(beam, ok=False, reason=f"{figures.saturated_px} px are saturated", remedy=_LESS_LIGHT)
    crosshair_px = reference_px(lever, pendulum_image.shape)
    return AlignmentFrame(image, full_scale_dn, figures, spot, crosshair_px, applied, beam, reference, limits)


_ELLIPSE_SIGMAS = 2.0
Picture = NDArray[np.uint8]


def annotated_picture(look: AlignmentFrame, width_px: int, height_px: int, zoom: float = 1.0) -> Picture:
    """Picture (ny, nx, 3) in RGB of the frame, or of its part around the spot, fitted into a size.

    Its sides keep their ratio. Saturated pixels stay visible however much the frame is reduced. `zoom` is the
    ratio of the frame to its shown part, which is centred on the spot, or on the crosshair without a spot.
    """
    left, top, region_width, region_height = _shown_region(look, zoom)
    region = look.image[top : top + region_height, left : left + region_width]
    scale = min(width_px / region_width, height_px / region_height)
    size = max(1, round(region_width * scale)), max(1, round(region_height * scale))
    # the root is taken of each possible value, not of each pixel, which is faster
    roots = np.sqrt(np.arange(np.iinfo(region.dtype).max + 1) / look.full_scale_dn)
    brightness = (255.0 * np.minimum(roots, 1.0)).round().astype(np.uint8)
    grey = _resized(brightness[region], size, scale)
    picture = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.uint8)
    line_width = max(1, round(min(size) / 300))

    def pixel(x_px: float, y_px: float) -> tuple[int, int]:
        return round((x_px - left + 0.5) * scale - 0.5), round((y_px - top + 0.5) * scale - 0.5)

    cross = pixel(*look.crosshair_px)
    blue = palette.rgba(palette.SKY_BLUE)[:3]
    cv2.line(picture, (cross[0], 0), (cross[0], size[1] - 1), blue, line_width)
    cv2.line(picture, (0, cross[1]), (size[0] - 1, cross[1]), blue, line_width)
    reference = look.reference
    if reference is not None:
        # below this line the frame is the reference's
        row = pixel(0.0, reference.from_row_px - 0.5)[1]
        cv2.line(picture, (0, row), (size[0] - 1, row), palette.rgba(palette.BLUISH_GREEN)[:3], line_width)
    for spot, colour in (
        *([(look.spot, palette.YELLOW)] if look.has_spot else []),
        *([(reference.spot, palette.BLUISH_GREEN)] if reference is not None and reference.has_spot else []),
    ):
        sigmas_px = spot.sigma_x_px, spot.sigma_y_px
        half_axes = tuple(max(1, round(_ELLIPSE_SIGMAS * sigma_px * scale)) for sigma_px in sigmas_px)
        rgb, angle_deg = palette.rgba(colour)[:3], math.degrees(spot.rotation_rad)
        centre = pixel(spot.x_px, spot.y_px)
        cv2.ellipse(picture, centre, half_axes, angle_deg, 0.0, 360.0, rgb, line_width)
    is_saturated = region >= look.full_scale_dn
    if is_saturated.any():
        # a pixel of the picture is marked if any part of it is saturated
        saturated = _resized(is_saturated.astype(np.float32), size, scale) > 0.0
        picture[saturated] = palette.rgba(palette.VERMILLION)[:3]
    return picture


def _shown_region(look: AlignmentFrame, zoom: float) -> tuple[int, int, int, int]:
    """Left, top, width and height of the shown part in px of the frame."""
    rows, columns = look.image.shape
    width, height = max(8, round(columns / zoom)), max(8, round(rows / zoom))
    x_px, y_px = (look.spot.x_px, look.spot.y_px) if look.has_spot else look.crosshair_px
    left = int(np.clip(round(x_px - 0.5 * width), 0, max(columns - width, 0)))
    top = int(np.clip(round(y_px - 0.5 * height), 0, max(rows - height, 0)))
    return left, top, min(width, columns), min(height, rows)


def _resized(values: NDArray[Any], size: tuple[int, int], scale: float) -> NDArray[Any]:
    """Resized values: means over areas if reduced, repeated pixels if enlarged."""
    interpolation = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    return cv2.resize(values, size, interpolation=interpolation)
