"""Finds, checks, opens and closes the devices: camera, controller, laser and sensors."""

from rig.devices import picture
from rig.devices.acknowledgement import LightWatch, TypedAcknowledgement, ask_leave, at_terminal
from rig.devices.audit import AUDIT_NAME, AuditEntry, check_log
from rig.devices.clocks import (
    U_FREE_RUNNING,
    U_QUARTZ,
    U_SYNCHRONISED,
    ClockAnchors,
    ClockRate,
    ntp_state,
    wrong_rate,
)
from rig.devices.doctor import examine
from rig.devices.frame_stream import FrameStream
from rig.devices.laser import STAYS_LIT, WIRE_IT, check_wiring, through_controller, wait_for_command
from rig.devices.lit_devices import NOT_OURS
from rig.devices.picture import PictureFigures, find_exposure
from rig.devices.session_devices import Devices, OpenCamera
from rig.devices.udev import RULES_FOLDER, feature_lines, install_rules, udev_rules, watch_latest
