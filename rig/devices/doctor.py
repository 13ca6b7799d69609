"""The command `rig doctor`: checks the whole rig without switching anything on, and installs udev rules."""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal, cast

from rich.console import Console

from acquisition import atomic_write
from acquisition.camera import CameraStatus, FrameTimeout
from acquisition.cameras.drivers import Usb3VisionSettings, frames_ahead
from acquisition.cameras.usb3vision.link import SUPER_SPEED, UDEV_RULE, FoundCamera, find_cameras
from acquisition.frames.losses import FrameLosses
from processing.errors import ConfigurationError, DeviceError, RigError
from processing.units import seconds
from rig.control import (
    UDEV_BOARD,
    UDEV_MATCHES,
    ControllerSettings,
    LaserSettings,
    SafetyState,
    check_controller,
    check_environment,
    check_laser,
)
from rig.devices.ground_seismometer import check_seismometer
from rig.devices.lit_devices import LEFT_LIT
from rig.devices.session_devices import Devices
from rig.instrument import check_materials, complete
from rig.settings import Configuration
from rig.terminal import Verdict, print_json_line, print_verdicts

_RATE_FRAMES = 60
"""Number of frames by which the rate is judged."""
_MAX_RATE_ERROR = 0.1
"""Largest relative error of the frame rate, which the host's clock measures over few frames; preflight checks
the rate by the camera's own clock with a narrower limit."""
_MIN_FREE_BYTES = 2e9
_GOVERNOR = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
_FREQUENCY_DRIVER = _GOVERNOR.with_name("scaling_driver")
_CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_OWN_GOVERNORS = {"intel_pstate", "amd-pstate-epp"}
"""Frequency drivers with governors of their own, by Linux's documentation of both."""
_STEADY_CLOCK_SOURCES = {"tsc", "kvm-clock", "hyperv_clocksource_tsc_page", "arch_sys_counter", "hpet"}


def examine(config: Configuration, *, json_lines: bool = False) -> int:
    """Print all checks; returns exit status 1 if one fails, else 0."""
    checks = []
    for check in _checks(config):
        checks.append(check)
        if json_lines:
            print_json_line("check", asdict(check))
    if not json_lines:
        print_verdicts(Console(), checks)
    return 0 if all(check.ok for check in checks) else 1


def _checks(original: Configuration) -> Iterator[Verdict]:
    config = complete(original)
    yield from check_settings(config, original)
    try:
        devices = Devices(config)
    except ConfigurationError as error:
        yield Verdict.failed("controller and laser", error)
        config = config.model_copy(update={"laser": LaserSettings(), "controller": ControllerSettings()})
        devices = Devices(config)
    try:
        with devices.state as state:
            yield check_trip(state, original.command_words)
            for verdict in check_controller(
                devices.make_controller(),
                config.controller,
                config.laser,
                config.environment_sensor,
                original.command_words,
            ):
                is_missing = verdict.name == "controller" and not verdict.ok and config.rehearsal_hint
                remedy = f"{verdict.remedy}; {config.rehearsal_hint}" if is_missing else verdict.remedy
                yield replace(verdict, remedy=remedy)
            yield from check_laser(config.laser)
    except DeviceError as error:
        yield Verdict.failed("controller and laser", error, "end that program, or use its window")
    if config.controller.kind == "none":
        for key, value, is_needed in (
            ("start.way", config.start.way, config.start.by_controller),
            ("environment_sensor.kind", "controller", config.environment_sensor.kind == "controller"),
        ):
            if is_needed:
                reason = f"{key} = {value!r}, but controller.kind = 'none'"
                # a run is possible without readings of ambient conditions
                is_fault = key == "start.way"
                yield Verdict("controller", not is_fault, reason, f"set controller.kind, or another {key}")
    yield from check_environment(config.environment_sensor)
    yield check_seismometer(config)
    if config.camera.driver == "usb3vision":
        yield from check_usb_cameras(cast(Usb3VisionSettings, config.camera.driver_settings()).serial)
    yield from check_camera(config, devices)
    yield check_disk(config.session.output)
    yield check_clock(_read(_CLOCK_SOURCE))
    yield check_governor(_read(_GOVERNOR), _read(_FREQUENCY_DRIVER), os.cpu_count() or 1)


def check_trip(state: SafetyState, config_words: str) -> Verdict:
    """Verdict on the latch of trips; `config_words` name the configuration in a command."""
    trip = state.trip
    if trip is None:
        remedy = (
            f"see whether the laser is lit; rig light show {config_words} then latches a trip and prints its "
            "number"
        )
        return Verdict.checked("latched trip", not state.left_lit, "no trip is latched", remedy, LEFT_LIT)
    remedy = f"check that nobody is in the beam path, then rig light acknowledge {config_words} {trip.number}"
    return Verdict("latched trip", False, trip.text, remedy)


def check_settings(config: Configuration, original: Configuration) -> Iterator[Verdict]:
    """Verdicts on what a fit needs of the configuration; `original` is the one before it was completed."""
    try:
        check_materials(config)
        origin = _origin("pendulum", config, original)
        remedy = "state mass_kg and ball_radius_m under [pendulum]"
        yield Verdict.checked("pendulum", bool(origin), origin, remedy, "not stated: nothing can be fitted")
    except RigError as error:
        yield Verdict.failed("pendulum", error, "correct the material")
    origin = _origin("lever", config, original)
    remedy = "state arm_m and pixel_pitch_m under [lever]"
    fault = "no calibration: amplitudes will be in px"
    yield Verdict.checked("light lever", bool(origin), origin, remedy, fault)
    noise = _origin("sensor", config, original)
    yield Verdict("sensor's noise", True, noise or "not stated: a typical sensor is assumed")


def _origin(
    section: Literal["pendulum", "lever", "sensor"], config: Configuration, original: Configuration
) -> str:
    """Origin of a section of the complete configuration, in words; empty if the section is missing."""
    if getattr(config, section) is None:
        return ""
    if getattr(original, section) is not None:
        return "stated"
    path = getattr(original.calibration, section, None)
    return "from its calibration" if path else "the simulated rig's own"


def check_camera(config: Configuration, devices: Devices) -> Iterator[Verdict]:
    """Verdicts on the camera, which is opened, gives some frames and is closed."""
    try:
        with devices.camera(config) as camera:
            info = camera.info
            yield Verdict("camera", True, f"{info.vendor} {info.model} {info.serial}".strip())
            remedy, notes = "request only what the camera supports", "; ".join(camera.notes)
            yield Verdict.checked("camera settings", not notes, "as requested", remedy, notes)
            camera.camera.start()
            arrivals, frame_bytes = [], 0
            for _ in range(_RATE_FRAMES):
                frame = camera.camera.read(config.camera.patience_s)
                if frame is None:
                    break
                arrivals.append((frame.sequence, frame.host_time_ns))
                frame_bytes = frame.image.nbytes
            status = camera.camera.status
            camera.camera.stop()
            requested_hz = None if config.camera.trigger else config.camera.frame_rate_hz
            yield check_frames(arrivals, status, requested_hz, on_demand=config.on_demand)
            if config.camera.driver == "usb3vision" and frame_bytes:
                frames = frames_ahead(camera.applied.frame_rate_hz, frame_bytes)
                yield from check_usb_memory(frame_bytes, frames)
    except FrameTimeout as error:
        yield Verdict.failed("frames", error, "is it triggered from outside? see its cable and power")
    except RigError as error:
        yield Verdict.failed("camera", error, "see camera.driver and camera.serial, its cable and power")


def check_frames(
    arrivals: Sequence[tuple[int, int]], status: CameraStatus, requested_hz: float | None, *, on_demand: bool
) -> Verdict:
    """Verdict on some frames: whether all came, and at the requested rate.

    Parameters
    ----------
    arrivals
        Number of each frame, and the host's clock when it arrived, in ns.
    requested_hz
        The requested rate; None if there is none, or if a trigger starts the exposures.
    on_demand
        Frames are made when they are read, and have no rate.
    """
    lost = f"lost: {FrameLosses.from_status(status)}"
    ok = len(arrivals) == _RATE_FRAMES and status.dropped == 0
    remedy = "" if ok else "another port or cable; a lower frame_rate_hz; a smaller region"
    if on_demand:
        return Verdict("frames", ok, f"{len(arrivals)}, made on demand: no rate to judge, {lost}", remedy)
    numbers, times_ns = zip(*arrivals, strict=True) if arrivals else ((0,), (0,))
    span_s = seconds(times_ns[-1] - times_ns[0])
    rate_hz = (numbers[-1] - numbers[0]) / span_s if span_s > 0 else 0.0
    result = f"{len(arrivals)} at {rate_hz:.3g} frames/s, {lost}"
    if ok and requested_hz is not None and abs(rate_hz / requested_hz - 1) > _MAX_RATE_ERROR:
        slow = "exposure too long, or the bus too slow: a shorter exposure, a smaller region, another port"
        fast = "the camera does not keep the rate: check it with rig camera show"
        result += f"; {requested_hz:g} were requested"
        return Verdict("frames", False, result, slow if rate_hz < requested_hz else fast)
    return Verdict("frames", ok, result, remedy)


def check_disk(output: Path) -> Verdict:
    """Verdict on the free space of the output folder, and on its permissions."""
    folder = output
    while not folder.exists():
        folder = folder.parent if folder.parent != folder else Path()
    free_bytes = shutil.disk_usage(folder).free
    writable = os.access(folder, os.W_OK)
    ok = writable and free_bytes > _MIN_FREE_BYTES
    text = f"{free_bytes / 1e9:.1f} GB free at {folder.resolve()}{'' if writable else ', not writable'}"
    return Verdict.checked("disk", ok, text, "free space, or set session.output")


def check_clock(source: str) -> Verdict:
    """Verdict on the kernel's clock source; with a slow one the arrival times of frames jitter."""
    if not source:
        return Verdict("clock", True, "this system does not report its clock source")
    remedy = "boot with clocksource=tsc where the processor has it"
    steady = source in _STEADY_CLOCK_SOURCES
    return Verdict.checked("clock", steady, f"the computer's time is from {source}", remedy)


def check_governor(governor: str, driver: str, processors: int) -> Verdict:
    """Verdict on the frequency governor, which must not slow the processor down while frames arrive."""
    if not governor:
        return Verdict("processor", True, f"{processors} cores; no frequency governor")
    # these drivers call the governor powersave that raises the frequency with the load
    is_dynamic = governor == "powersave" and driver in _OWN_GOVERNORS
    ok = is_dynamic or governor not in {"powersave", "conservative"}
    remedy = "cpupower frequency-set -g performance"
    return Verdict.checked("processor", ok, f"{processors} cores, governor {governor}", remedy)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""


_USBFS_MEMORY = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")


def check_usb_camera(camera: FoundCamera) -> tuple[Verdict, ...]:
    """Verdicts on the permission to open the camera, and on the negotiated USB speed."""
    permission = Verdict.checked(
        "camera permission",
        camera.accessible,
        camera.name,
        f"only root may open USB devices unless a udev rule allows it: {as_root()}, "
        "then plug the camera in again",
        f"no permission to open {camera.name}",
    )
    slow = 0 < camera.usb_speed < SUPER_SPEED
    remedy = "use a USB 3 port (blue, or marked SS) and a USB 3 cable, without a hub"
    return permission, Verdict.checked("camera USB speed", not slow, camera.speed_text, remedy)


def check_usb_cameras(serial: str | None) -> Iterator[Verdict]:
    """Verdicts on the USB3 Vision cameras that may have this serial number; None: all of them."""
    try:
        cameras = find_cameras()
    except DeviceError as missing:
        yield Verdict("libusb", False, str(missing), "pip install libusb-package")
        return
    for camera in cameras:
        if serial is None or not camera.serial or camera.serial == serial:
            yield from check_usb_camera(camera)


def check_usb_memory(frame_bytes: int, frames: int, memory: Path = _USBFS_MEMORY) -> tuple[Verdict, ...]:
    """Verdict on Linux's memory for the USB transfers of `frames` frames, which use half of it at most."""
    if sys.platform != "linux" or not memory.is_file():
        return ()
    limit_mb = int(memory.read_text(encoding="utf-8"))
    needed_mb = -(-2 * frames * frame_bytes // 2**20)
    # 0 means no limit
    enough = limit_mb == 0 or limit_mb >= needed_mb
    text = f"{limit_mb} MB for all USB devices, {frames} frames ahead need {needed_mb} MB"
    return (Verdict.checked("USB buffer memory", enough, text, f"echo {needed_mb} | sudo tee {memory}"),)


RULES_FOLDER = Path("/etc/udev/rules.d")
_RULES_FILE = "70-optical-pendulum-rig.rules"
_RULE_ACCESS = 'MODE="0660", TAG+="uaccess"'
_RULES_HEAD = """\
# Devices of an optical pendulum rig, written by rig doctor --install-udev: the user at the computer may use
# them, and so may a group, for services and remote users.
# The number must stay below 73, where systemd grants what the tag "uaccess" asks for."""


def udev_rules() -> str:
    """The text of the file, with a rule for each kind of device that a driver of this program opens itself.

    Video4Linux's nodes have systemd's own rules, and cameras on a network have no node.
    """
    lines = [
        _RULES_HEAD,
        "# USB3 Vision cameras of every make, also for pylon and libaravis",
        f'{UDEV_RULE}, GROUP="plugdev", {_RULE_ACCESS}',
    ]
    for kind, match in UDEV_MATCHES.items():
        group = "dialout" if "tty" in match else "plugdev"
        lines += [f"# {kind}", f'{match}, GROUP="{group}", {_RULE_ACCESS}']
    lines += [
        "# ModemManager writes to every new serial port: not to the board that switches the laser",
        f'{UDEV_BOARD}, ENV{{ID_MM_DEVICE_IGNORE}}="1"',
    ]
    return "\n".join(lines) + "\n"


def as_root() -> str:
    """The command by which a user who is not root installs the rules."""
    return shlex.join(["sudo", sys.executable, "-m", "rig", "doctor", "--install-udev"])


def install_rules(folder: Path = RULES_FOLDER) -> tuple[Path, str]:
    """Write the file, replacing that of an earlier version; returns its path and the next instruction.

    Raises ConfigurationError where this system has no udev, or no such folder, and DeviceError where the file
    cannot be written, or only by root.
    """
    if sys.platform != "linux":
        raise ConfigurationError("--install-udev: udev is a part of Linux; this system needs no such rules")
    if folder == RULES_FOLDER and not folder.is_dir():
        raise ConfigurationError(f"{folder}: no such folder; this system has no udev, and needs no rules")
    path = folder / _RULES_FILE
    try:
        atomic_write.replace(path, udev_rules().encode(), mode=0o644)
    except PermissionError:
        raise DeviceError(f"{path}: only root may write it: {as_root()}") from None
    except OSError as error:
        raise DeviceError(f"{path}: cannot be written: {error.strerror or error}") from None
    next_step = "plug the devices in again"
    if folder == RULES_FOLDER and not _reload_rules():
        next_step = f"sudo udevadm control --reload, then {next_step}"
    return path, next_step


def _reload_rules() -> bool:
    """Make udev's daemon read the rules again; False if that fails, as in a container without one."""
    udevadm = shutil.which("udevadm")
    if udevadm is None or os.geteuid() != 0:
        return False
    result = subprocess.run([udevadm, "control", "--reload"], capture_output=True, timeout=30, check=False)
    return result.returncode == 0
