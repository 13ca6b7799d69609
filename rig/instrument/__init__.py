"""The configured instrument: calibration, pipeline from frames to swings, provenance, state of a run."""

from rig.instrument.balance import (
    BALANCE_CONDITIONS,
    DIRECTIONS,
    PLANE_OF_SWING,
    WEIGHTS,
    advice_for,
    balance_failures,
    balance_verdicts,
    height_of,
    nominal_effects,
    run_balance_verdicts,
    sensor_room,
    turn_text,
)
from rig.instrument.beam_verdict import NO_STRAY_LIGHT, beam_quality
from rig.instrument.calibration import fill_from_files, judge_calibration
from rig.instrument.configured_camera import (
    camera_settings,
    check_full_scale,
    frame_policy,
    make_camera,
    pulse_faults,
    setting_differences,
    shift_to_light_ns,
    shutter_of,
    with_read_back,
)
from rig.instrument.kernels import prepare_kernels
from rig.instrument.less_beam import LESS_BEAM, LessBeam
from rig.instrument.pendulum import balls, check_materials, material, pendulum_on_ball
from rig.instrument.pipeline import Block, Deflector, Optics, Pipeline, optics_of, sensor_model
from rig.instrument.provenance import (
    CONFIGURATION_NAME,
    code_identity,
    configuration_attachments,
    frame_shape,
    inputs_sha256,
    recorded_configuration,
    session_metadata,
    versions,
)
from rig.instrument.run_now import CameraClock, Phase, RunNow, Told, rate_text, told_in
from rig.instrument.simulated_rig import complete
from rig.instrument.wall import Wall
