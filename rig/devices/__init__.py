"""Finds, checks, opens and closes the devices: camera, controller, laser and sensors."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rig.devices import picture
from rig.devices.acknowledgement import LightWatch, TypedAcknowledgement, ask_leave, at_terminal
from rig.devices.audit import AUDIT_NAME, AuditEntry, check_log
from rig.devices.clocks import (
    ClockAnchors,
    ClockRate,
    ntp_state,
    wrong_rate,
)
from rig.devices.doctor import examine
from rig.devices.frame_stream import FrameStream
from rig.devices.laser import STAYS_LIT, WIRE_IT, check_wiring, through_controller, wait_for_command
from rig.devices.lit_devices import NOT_OURS
from rig.devices.order_line import NoSession, OrderConnection, SessionBusy, running_sessions
from rig.devices.order_socket import LOOPBACK, ORDERS_NAME, Orders, OrderSocket, light_told, safety_values
from rig.devices.picture import PictureFigures, find_exposure, png_of, read_frames
from rig.devices.session_devices import Devices, OpenCamera
from rig.devices.session_news import PATH_S, SessionNews, SessionPicture, thinned_path
from rig.devices.udev import RULES_FOLDER, feature_lines, install_rules, udev_rules, watch_latest

if TYPE_CHECKING:
    from rig.devices.aligning import align_camera
    from rig.devices.alignment_look import (
        AlignmentFrame,
        SeenReference,
        annotated_picture,
        middle_of,
        take_look,
    )

_LATER = {
    "align_camera": "aligning",
    "AlignmentFrame": "alignment_look",
    "SeenReference": "alignment_look",
    "annotated_picture": "alignment_look",
    "middle_of": "alignment_look",
    "take_look": "alignment_look",
}
"""Names that are imported on first use, with their modules, which import slow libraries."""


if not TYPE_CHECKING:  # which would take any name for one of this room

    def __getattr__(name: str) -> Any:
        if name not in _LATER:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
