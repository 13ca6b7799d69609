"""The configured instrument: calibration, pipeline from frames to swings, provenance, state of a run."""

from rig.instrument.balance import (
    DIRECTIONS,
    WEIGHTS,
    advice_text,
    advise,
    height_of,
    nominal_effects,
    sensor_room,
    turn_text,
)
from rig.instrument.beam_verdict import beam_quality
from rig.instrument.calibration import fill_from_files, judge_calibration
from rig.instrument.configured_camera import (
    camera_settings,
    check_full_scale,
    frame_policy,
    make_camera,
    setting_differences,
)
from rig.instrument.kernels import prepare_kernels
from rig.instrument.light_times import pulse_faults, shift_to_light_ns, shutter_of
from rig.instrument.optics import Optics, optics_of, sensor_model
from rig.instrument.pendulum import balls, check_materials, material, pendulum_on_ball
from rig.instrument.pipeline import Block, Deflector, Pipeline
from rig.instrument.provenance import (
    CONFIGURATION_NAME,
    configuration_attachments,
    earlier_schema,
    frame_shape,
    inputs_sha256,
    recorded_configuration,
    session_metadata,
    versions,
)
from rig.instrument.simulated_rig import complete
from rig.instrument.snapshot import Phase, Snapshot

__all__ = [
    "CONFIGURATION_NAME",
    "DIRECTIONS",
    "WEIGHTS",
    "Block",
    "Deflector",
    "Optics",
    "Phase",
    "Pipeline",
    "Snapshot",
    "advice_text",
    "advise",
    "balls",
    "beam_quality",
    "camera_settings",
    "check_full_scale",
    "check_materials",
    "complete",
    "configuration_attachments",
    "earlier_schema",
    "fill_from_files",
    "frame_policy",
    "frame_shape",
    "height_of",
    "inputs_sha256",
    "judge_calibration",
    "make_camera",
    "material",
    "nominal_effects",
    "optics_of",
    "pendulum_on_ball",
    "prepare_kernels",
    "pulse_faults",
    "recorded_configuration",
    "sensor_model",
    "sensor_room",
    "session_metadata",
    "setting_differences",
    "shift_to_light_ns",
    "shutter_of",
    "turn_text",
    "versions",
]
