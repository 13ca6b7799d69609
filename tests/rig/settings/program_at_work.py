"""Runs parts of the program with every section of a configuration, each for at most some seconds."""

import time
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from acquisition.camera import CameraInfo, CameraSettings
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.simulation.ground import SimulatedSeismometer
from acquisition.simulation.inputs import FaultSettings, RigInputs
from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import true_turning_points
from processing.errors import RigError
from rig.control import (
    AmbientSensor,
    Controller,
    ControllerSettings,
    ControlService,
    EnvironmentSettings,
    LaserReport,
    Light,
    SafetyNow,
    SeismometerReader,
    SeismometerSettings,
    sensors,
    simulated_controller,
)
from rig.devices import Devices, FrameStream, OpenCamera
from rig.devices.ground_seismometer import make_seismometer
from rig.instrument import camera_settings, complete, make_camera, optics_of
from rig.instrument.configured_camera import shift_to_light_ns
from rig.measure.phases import PhasesBeforeRecord
from rig.measure.run import MeasurementRun
from rig.measure.run_parts import RunPlan
from rig.measure.session import measure_session, session_folder
from rig.prepare.balancing import measure
from rig.settings import Configuration, load_configuration
from rig.view import BalanceView
from rig.view.show import show_record
from tests.rig.command_line import CONFIGS, SMALL
from tests.rig.control.instruments import FakeObis, FakeThorlabs
from tests.rig.known_rig import known

DEMO = CONFIGS / "demo.toml"
NOWHERE = "/dev/no-such-port"


def configuration(**changes: str | float | bool) -> Configuration:
    """The small demonstration with dotted keys changed (``__`` for a dot)."""
    words = {**SMALL, **{key.replace("__", "."): str(value) for key, value in changes.items()}}
    return load_configuration(DEMO, [f"{key}={value}" for key, value in words.items()])


def measure_one_session(folder: Path) -> None:
    """Camera to report: session, record, view, fit, pendulum, lever."""
    config = configuration(session__max_duration_s=2)
    measure_session(config, DEMO, folder / "out")
    # as the viewer's own process does
    show_record(folder / "out" / "run-1.mcap", rrd=folder / "again.rrd")
    session_folder(config.model_copy(update={"session": _in(config, folder)}), DEMO, None)


def _in(config: Configuration, folder: Path) -> Any:
    return config.session.model_copy(update={"output": folder / "runs"})


class _Obedient:
    """A controller or laser that carries everything out."""

    def __getattr__(self, name: str) -> Any:
        done: Future[None] = Future()
        done.set_result(None)
        return lambda *_: done


class _Stubs:
    """Devices with a controller and a laser that are not there."""

    control = _Obedient()
    seismometer = None
    permit = SimpleNamespace(latched=None)

    def laser_report(self) -> LaserReport:
        return LaserReport(Light.ON)

    def safety(self) -> SafetyNow:
        return SafetyNow(light=Light.ON)

    def darkness(self) -> str:
        return ""

    def compare(self) -> None: ...

    def environment(self) -> tuple[float, float, float]:
        return 20.0, 50.0, 1e5

    def take_events(self) -> list[tuple[str, str]]:
        return []

    def required_control(self, who: str) -> _Obedient:
        return self.control


def go_through_the_phases(folder: Path) -> None:
    """Rest, warm-up, preflight and release of a pendulum that is pushed at 9 s."""
    config = complete(
        configuration(
            start__way='"starter"',
            simulation__release__at_s=9.0,
            simulation__release__way='"push"',
            preflight__when='"always"',
            preflight__duration_s=0.6,
            preflight__max_clock_jitter_us=1e9,
            phases__rest_window_s=1.0,
            phases__warm_up_window_s=2.1,
            phases__warm_up_drift_arcsec_per_min=1e3,
            laser__kind='"controller"',
            start__pretrigger_s=0.1,
            session__max_duration_s=0.5,
        )
    )
    camera = make_camera(config)
    opened = OpenCamera(camera, camera.open(), ())
    asked = camera_settings(config)
    camera.configure(asked)
    optics = optics_of(config, opened.info.full_scale_dn)
    devices: Any = _Stubs()
    plan = RunPlan(config, DEMO, folder / "phases.mcap", "run 1", force=True)
    phases = PhasesBeforeRecord(plan, devices, opened, optics)
    outcome = MeasurementRun(
        plan=plan,
        camera=opened,
        stream=FrameStream(camera, asked, policy="wait"),
        optics=optics,
        phases=phases,
        devices=devices,
    ).execute()
    assert outcome.failure is None, outcome.failure
    phases.correct_starter(1e-4)


def look_at_the_balance() -> None:
    """Some periods of swinging."""
    config = complete(configuration(balance__seconds=9.1))
    with Devices(config) as devices:
        measure(config, devices, lambda _: None, BalanceView(config, None, lambda _: "", lambda _: None))


def talk_to_the_controller() -> None:
    """The simulated one, and one at a port that is not there."""
    settings = ControllerSettings(kind="simulated")
    with ControlService(simulated_controller(settings, 1e-3), settings) as service:
        service.wait_open()
        service.submit(lambda c: c.starter_pulse(0.05)).result(5.0)
    with pytest.raises(RigError):
        Controller(ControllerSettings(kind="serial", port=NOWHERE), 1e-3).open()
    Devices(configuration(controller__kind='"simulated"', simulation__real_time="true")).make_controller()


def pulse_the_laser() -> None:
    """Light that comes within the exposure, some time after its begin."""
    laser = {"kind": "controller", "power_w": 1e-4, "pulse_us": 50.0, "pulse_delay_us": 100.0}
    config = Configuration.model_validate({"camera": {"driver": "simulated"}, "laser": laser})
    info = CameraInfo("any", "", "", "", 640, 480, 255, has_clock=True)
    assert shift_to_light_ns(config, info, CameraSettings(exposure_us=200.0)) == 125_000


def light_the_lasers() -> None:
    """One that is set in watts, one in amperes, each behind its port."""
    for kind, family, value in (("obis", FakeObis, "power_w"), ("thorlabs4000", FakeThorlabs, "current_a")):
        instrument = family()
        known(instrument.port)
        laser = {"kind": kind, "port": instrument.port, value: 0.02, f"max_{value}": 0.03, "timeout_s": 2.0}
        try:
            tree = {"camera": {"driver": "simulated"}, "laser": laser}
            with Devices(Configuration.model_validate(tree)) as devices:
                devices.light()
        finally:
            instrument.close()


def read_the_environment() -> None:
    """A sensor that must be asked, and one at a port that is not there."""

    class Line:
        name = "line"

        def write(self, data: bytes) -> None: ...

        def read(self, timeout_s: float) -> bytes:
            return b"20.0, 50.0, 1000.0\n"

        def discard_input(self) -> None: ...

        def close(self) -> None: ...

    settings = EnvironmentSettings(kind="serial", port=NOWHERE, request="R")
    with pytest.MonkeyPatch.context() as patched:
        for is_there in (True, False):
            if is_there:
                patched.setattr(sensors, "SerialPort", lambda *_: Line())
            with AmbientSensor(settings) as service:
                deadline_s = time.monotonic() + 5.0
                while time.monotonic() < deadline_s and not (service.last_line or service.last_error):
                    time.sleep(0.01)
            patched.undo()


def choose_a_camera() -> None:
    """A camera that is not there, by its serial number."""
    make_camera(Configuration.model_validate({"camera": {"driver": "v4l2", "serial": "1"}}))


def suffer_every_fault() -> None:
    """A small simulated camera to which everything happens within a second."""
    faults = FaultSettings(
        laser_fades_at_s=0.1,
        camera_unplugged_at_s=0.5,
        camera_replugged_at_s=0.6,
        frames_stalled_at_s=0.2,
        frames_stalled_duration_s=0.1,
        vibration_burst_at_s=0.1,
        draught_at_s=0.1,
    )
    tiny = {
        "disturbances": {
            "air_arcsec": 0.1,
            "microphonics": [{"frequency_hz": 50.0, "amplitude_px": 0.1}],
            "camera_slips_at_s": 0.1,
        },
        "sensor": {"width_px": 32, "height_px": 32, "row_time_s": 1e-5},
        "optics": {"arm_m": 0.02, "sigma_x_px": 2, "sigma_y_px": 2},
    }
    camera = SimulatedCamera(SimulationSettings.model_validate(tiny), faults)
    _read(camera, 60)
    real = SimulationSettings.model_validate(
        {**tiny, "real_time": True, "release": {"way": "by command"}, "clock": {"frame_rate_hz": 200}}
    )
    inputs = RigInputs()
    for act in (inputs.starter, inputs.brake):
        act(True)
    _read(SimulatedCamera(real, FaultSettings(clock_steps_at_s=0.05), inputs), 20)


def listen_to_the_ground() -> None:
    """Seismometers at a port that is not there, and beside the simulated rig."""
    with SeismometerReader(
        SeismometerSettings(kind="serial", port=NOWHERE, columns=("time_s", "z"))
    ) as service:
        service._take("0.1 5", 1)
        deadline_s = time.monotonic() + 5.0
        while time.monotonic() < deadline_s and not service.take_events():
            time.sleep(0.01)
        assert service.stale
    truth = SimulationSettings.model_validate({"ground": {"model": "white"}})
    assert len(SimulatedSeismometer(truth).until(1.0, 0).counts)
    port = f"'{NOWHERE}'"
    config = configuration(seismometer__kind="'serial'", seismometer__port=port, simulation__real_time="true")
    seismometer = make_seismometer(config)
    assert seismometer is not None
    assert seismometer.problem


def see_a_reference(folder: Path) -> None:
    """A second spot below the pendulum's, in air."""
    words = {
        "reference.from_row_px": 600,
        "reference.gain": 1.0,
        "simulation.reference.relative": 0.5,
        "simulation.reference.y_px": 620,
    }
    words |= {"simulation.disturbances.air_arcsec": 0.01, "simulation.reference.air_common": 0.9}
    config = configuration(session__max_duration_s=6, **{k.replace(".", "__"): v for k, v in words.items()})
    measure_session(config, DEMO, folder / "reference")


def shake_the_ground(folder: Path) -> None:
    """Ground of every model."""
    file = folder / "ground.csv"
    file.write_text("\n".join(["time_s,a_nm_per_s2", *(f"{t},{(-1) ** t}" for t in range(200))]) + "\n")
    for model in ("white", "peterson", "file"):
        ground = {"model": model, "file": str(file), "tilt_rad_per_sqrt_hz": 1e-9}
        truth = SimulationSettings.model_validate({"ground": ground})
        assert len(true_turning_points(truth, max_duration_s=10.0).time_s)


def _read(camera: SimulatedCamera, count: int) -> None:
    camera.open()
    camera.configure(CameraSettings())
    camera.start()
    for _ in range(count):
        try:
            camera.read(1.0)
        except RigError:
            camera.open()
            camera.start()
    camera.close()
