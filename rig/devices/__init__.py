"""Finds, checks, opens and closes the devices: camera, controller, laser and sensors."""

from rig.devices import picture
from rig.devices.acknowledgement import LightWatch, TypedAcknowledgement, ask_acknowledgement, at_terminal
from rig.devices.aligning import align_camera
from rig.devices.alignment_look import (
    AlignmentFrame,
    ReferenceSpot,
    annotated_picture,
    take_look,
)
from rig.devices.audit import AuditEntry
from rig.devices.clocks import ClockAnchors, ClockRate, impossible_rate_text
from rig.devices.doctor import RULES_FOLDER, examine, install_rules, udev_rules
from rig.devices.frame_stream import FrameStream
from rig.devices.laser import STAYS_LIT, WIRING_REMEDY, check_wiring, through_controller, wait_for_command
from rig.devices.light_off import MAX_ANSWER_S, LightOff
from rig.devices.lit_devices import SWITCHED_BY_HAND
from rig.devices.order_line import NoSession, OrderConnection, SessionBusy, running_sessions
from rig.devices.order_socket import (
    LOOPBACK,
    ORDERS_NAME,
    PATH_S,
    Orders,
    OrderSocket,
    SessionNews,
    SessionPicture,
    light_orders,
    light_shown_to_desk,
    safety_values,
    thinned_path,
)
from rig.devices.picture import feature_lines, find_exposure, png_of, read_frames
from rig.devices.session_devices import Devices, OpenCamera
