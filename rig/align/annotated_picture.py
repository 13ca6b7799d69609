"""The frame as a colour picture: light on a square-root scale, saturation, crosshair, the spot's ellipse."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.align.look import AlignmentFrame
from rig.presentation import palette

_ELLIPSE_SIGMAS = 2.0
Picture = NDArray[np.uint8]


def annotated_picture(look: AlignmentFrame, width_px: int, height_px: int, zoom: float = 1.0) -> Picture:
    """The whole frame, or its part around the spot, fitted into a size; RGB (height, width, 3).

    Saturated pixels stay visible however much the frame is reduced. With a `zoom` above 1 the part is so
    much smaller than the frame, and centred on the spot, or on the crosshair where there is none.

    Returns
    -------
    array
        At most (height_px, width_px, 3), with the part's own ratio of sides.
    """
    left, top, part_width, part_height = _part(look, zoom)
    part = look.image[top : top + part_height, left : left + part_width]
    scale = min(width_px / part_width, height_px / part_height)
    size = max(1, round(part_width * scale)), max(1, round(part_height * scale))
    # a root for each value that there can be, not for each pixel
    roots = np.sqrt(np.arange(np.iinfo(part.dtype).max + 1) / look.full_scale_dn)
    drawn = _resized(roots[part], size, scale)
    picture = np.repeat((255.0 * np.clip(drawn, 0.0, 1.0)).astype(np.uint8)[..., np.newaxis], 3, axis=2)
    thin = max(1, round(min(size) / 300))

    def at(x_px: float, y_px: float) -> tuple[int, int]:
        return round((x_px - left + 0.5) * scale - 0.5), round((y_px - top + 0.5) * scale - 0.5)

    cross = at(*look.middle_px)
    blue = palette.rgba(palette.SKY_BLUE)[:3]
    cv2.line(picture, (cross[0], 0), (cross[0], size[1] - 1), blue, thin)
    cv2.line(picture, (0, cross[1]), (size[0] - 1, cross[1]), blue, thin)
    reference = look.reference
    if reference is not None:
        # from this line on the frame is the reference's
        row = at(0.0, reference.from_row_px - 0.5)[1]
        cv2.line(picture, (0, row), (size[0] - 1, row), palette.rgba(palette.BLUISH_GREEN)[:3], thin)
    for spot, colour in (
        *([(look.spot, palette.YELLOW)] if look.found else []),
        *([(reference.spot, palette.BLUISH_GREEN)] if reference is not None and reference.found else []),
    ):
        half = tuple(max(1, round(_ELLIPSE_SIGMAS * s * scale)) for s in (spot.sigma_x_px, spot.sigma_y_px))
        rgb = palette.rgba(colour)[:3]
        angle_deg = math.degrees(spot.rotation_rad)
        cv2.ellipse(picture, at(spot.x_px, spot.y_px), half, angle_deg, 0.0, 360.0, rgb, thin)
    full = part >= look.full_scale_dn
    if full.any():
        # of a pixel of the picture any part may be saturated
        saturated = _resized(full.astype(np.float64), size, scale) > 0.0
        picture[saturated] = palette.rgba(palette.VERMILLION)[:3]
    return picture


def _part(look: AlignmentFrame, zoom: float) -> tuple[int, int, int, int]:
    """Left, top, width and height of the part that is shown."""
    rows, columns = look.image.shape
    width, height = max(8, round(columns / zoom)), max(8, round(rows / zoom))
    x_px, y_px = (look.spot.x_px, look.spot.y_px) if look.found else look.middle_px
    left = int(np.clip(round(x_px - 0.5 * width), 0, max(columns - width, 0)))
    top = int(np.clip(round(y_px - 0.5 * height), 0, max(rows - height, 0)))
    return left, top, min(width, columns), min(height, rows)


def _resized(values: NDArray[np.float64], size: tuple[int, int], scale: float) -> NDArray[np.float64]:
    """Means over areas when made smaller, single pixels when made larger."""
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(values, size, interpolation=way), dtype=np.float64)
