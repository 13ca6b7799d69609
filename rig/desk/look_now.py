"""The picture as it is now: of the running session, else of the camera that is being aligned."""

import cv2
import numpy as np

from acquisition.camera import CameraSettings
from rig.align import AlignmentFrame, annotated_picture, middle_of
from rig.desk.desk import Desk
from rig.devices import picture


def look_now(desk: Desk) -> AlignmentFrame | None:
    """The newest look; None without one. Of a session's beam nothing is judged here: its state says it."""
    if desk.aligner is not None:
        return desk.aligner.look
    seen, camera = desk.following.picture(), desk.following.news.get("camera") or {}
    if seen is None or "full_scale_dn" not in camera:
        return None
    full_scale_dn, stated = int(camera["full_scale_dn"]), camera["reference_px"]
    figures = picture.figures(seen.image, full_scale_dn)
    reference_px = None if stated is None else (float(stated[0]), float(stated[1]))
    middle_px = middle_of(seen.image, reference_px)
    applied = CameraSettings.model_validate(camera["applied"])
    return AlignmentFrame(seen.image, full_scale_dn, figures, seen.spot, middle_px, applied)


def picture_now(desk: Desk, width_px: int, height_px: int, zoom: float) -> bytes:
    """The newest look as PNG of this size, with all that is drawn into it; black without one."""
    look = look_now(desk)
    shown = np.zeros((height_px, width_px, 3), np.uint8)
    if look is not None:
        drawn = annotated_picture(look, width_px, height_px, zoom)
        rows, columns = drawn.shape[:2]
        left, top = (width_px - columns) // 2, (height_px - rows) // 2
        shown[top : top + rows, left : left + columns] = drawn
    done, png = cv2.imencode(".png", shown[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return png.tobytes() if done else b""
