"""Serial devices of the rig: controller, laser driver, environment sensor."""

from rig.control.controller import Controller
from rig.control.device_thread import run_in_thread
from rig.control.laser_service import LONGEST_JOB_S, LaserService
from rig.control.lasers import LASERS, LaserSettings, LaserState, make_laser
from rig.control.light_permit import NEEDS_REQUEST, Interlock, LightPermit, LightRefused, Stage
from rig.control.ports import (
    UDEV_BOARD,
    UDEV_MATCHES,
    check_controller,
    check_environment,
    check_laser,
    list_serial_ports,
)
from rig.control.presses import darken_directly
from rig.control.protocol import ControllerReset, ControllerStatus, Trip
from rig.control.safety_state import LatchedTrip, SafetyState, TripCause, rig_state_path, state_folder
from rig.control.sensors import AmbientSensor, SeismometerReader
from rig.control.service import ControlService, ControlState
from rig.control.settings import ControllerSettings, EnvironmentSettings, SeismometerSettings
from rig.control.simulated import simulated_controller
from rig.control.states import STALE_S, LaserReport, Light, Loop, SafetyNow
