"""The configured instrument: calibration, pipeline from frames to half-cycles, provenance, run state."""

from rig.instrument.balance import (
    BALANCE_CONDITIONS,
    DIRECTIONS,
    PLANE_OF_SWING,
    WEIGHTS,
    advice_for,
    balance_failures,
    balance_verdicts,
    balls,
    check_materials,
    mass_centre_height,
    material,
    nominal_effects,
    pendulum_on_ball,
    run_balance_verdicts,
    sensor_room,
    swing_text,
    turn_text,
)
from rig.instrument.beam_verdict import NO_STRAY_LIGHT, beam_quality
from rig.instrument.calibration import fill_from_files, judge_calibration
from rig.instrument.configured_camera import (
    ObserverGuard,
    camera_settings,
    check_full_scale,
    complete,
    make_camera,
    pulse_faults,
    setting_differences,
    shift_to_light_ns,
    shutter_of,
    with_read_back,
)
from rig.instrument.pipeline import (
    Block,
    Optics,
    Pipeline,
    optics_of,
    reference_px,
    sensor_model,
)
from rig.instrument.provenance import (
    CONFIGURATION_NAME,
    code_identity,
    configuration_attachments,
    frame_shape,
    inputs_sha256,
    prepare_kernels,
    recorded_configuration,
    session_metadata,
    u_of_host_rate,
    versions,
)
from rig.instrument.run_now import (
    U_QUARTZ,
    CameraClock,
    Phase,
    RecordContents,
    RunNow,
    piece_contents,
    rate_text,
)
