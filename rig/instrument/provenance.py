"""Provenance of a record (configuration, software versions, host), and compilation of the kernels."""

import functools
import hashlib
import importlib.metadata
import json
import platform
import socket
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from acquisition.camera import CameraInfo, Frame
from acquisition.record.digest import camera_metadata
from acquisition.record.reader import RecordReader
from acquisition.record.topics import CLOCK
from processing import spot as spots
from processing import swing as swings
from processing.errors import ConfigurationError, RecordError
from processing.kernel import notify_of_compilation
from processing.spot import SensorModel, SpotTracker
from rig.instrument.calibration import calibration_attachments
from rig.instrument.run_now import U_FREE_RUNNING, U_SYNCHRONISED
from rig.settings import (
    Configuration,
    apply_overrides,
    fault_line,
    stored_configuration,
    validate_configuration,
    without_schema,
)

CONFIGURATION_NAME = "configuration.json"
SOURCE_NAME = "configuration.toml"
RECORD_DESCRIPTION = "record.md"
_INPUTS = ("configuration.", "calibration/")
_ROOT = Path(__file__).resolve().parents[2]
_NUMERICAL_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless")
_PACKAGES = ("optical-pendulum-rig", *_NUMERICAL_PACKAGES, "mcap", "rerun-sdk")


def versions() -> dict[str, str]:
    """Versions of this program and of the libraries that influence the numbers."""
    version_of = {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "commit": code_commit(),
    }
    for name in _PACKAGES:
        try:
            version_of[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            version_of[name] = "not installed"
    return version_of


@functools.cache
def code_identity() -> str:
    """Identity of the sources that run, for example `0.1.0 (394556fc) 5f1c0e9d0a7b3c24`.

    The commit alone does not identify them: a checkout may be changed, and an installation has none.
    """
    digest = hashlib.sha256()
    for package in ("rig", "acquisition", "calibration", "processing"):
        for path in sorted((_ROOT / package).rglob("*.py")):
            digest.update(f"{path.relative_to(_ROOT).as_posix()}\0".encode() + path.read_bytes())
    version_of = versions()
    digest.update("".join(f"{name} {version_of[name]}\n" for name in _NUMERICAL_PACKAGES).encode())
    return f"{version_of[_PACKAGES[0]]} ({version_of['commit'][:8]}) {digest.hexdigest()[:16]}"


@functools.cache
def code_commit() -> str:
    """The commit of this code, from the checkout it runs from or the installed package; else "unknown".

    A checkout whose files differ from the commit gets the addition "changed".
    """
    arguments = ["describe", "--always", "--abbrev=40", "--dirty=, changed", "--exclude=*"]
    try:
        git = subprocess.run(
            ["git", "-C", str(_ROOT), *arguments],
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=5.0,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        if git.returncode == 0 and (_ROOT / ".git").exists():
            return git.stdout.strip()
        origin = importlib.metadata.distribution(_PACKAGES[0]).read_text("direct_url.json")
        return str(json.loads(origin or "{}")["vcs_info"]["commit_id"])
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, ImportError):
        return "unknown"


def session_metadata(config: Configuration, info: CameraInfo, frame: Frame) -> dict[str, dict[str, str]]:
    """Metadata of a record, by section: session, conditions, camera, software versions, shape of frames."""
    session = config.session
    environment = config.environment.model_dump(exclude_none=True)
    return {
        "session": {
            "operator": session.operator,
            "sample": session.sample,
            "contact_history": session.contact_history,
            **{
                name: getattr(session, name).isoformat()
                for name in ("contact_made", "surfaces_cleaned")
                if getattr(session, name) is not None
            },
            "notes": session.notes,
            "host": socket.gethostname(),
        },
        "environment": {key: f"{value:g}" for key, value in environment.items()},
        **camera_metadata(info),
        "frame": {"width_px": str(frame.image.shape[1]), "height_px": str(frame.image.shape[0])},
        "versions": versions(),
    }


def configuration_attachments(config: Configuration, source: Path) -> dict[str, bytes]:
    """Files to attach to a record: the complete configuration, the user's original file, calibrations."""
    text = json.dumps(stored_configuration(config), indent=1, ensure_ascii=False)
    attachments = {CONFIGURATION_NAME: text.encode()}
    if source.is_file() and source.suffix == ".toml":
        attachments[SOURCE_NAME] = source.read_bytes()
    for folder in (_ROOT / "docs" / "reference", _ROOT / "rig"):
        # a description of the format, for readers without this program
        if (path := folder / RECORD_DESCRIPTION).is_file():
            attachments[RECORD_DESCRIPTION] = path.read_bytes()
            break
    return {**attachments, **calibration_attachments(config)}


def inputs_sha256(reader: RecordReader) -> dict[str, str]:
    """SHA-256 of the configuration and of every calibration in a record, by attachment name."""
    inputs = {name: data for name, data in reader.attachments.items() if name.startswith(_INPUTS)}
    return {name: hashlib.sha256(data).hexdigest() for name, data in sorted(inputs.items())}


def frame_shape(reader: RecordReader) -> tuple[int, int]:
    """(ny, nx) of the frames of a record."""
    frame = reader.metadata.get("frame")
    if frame is None:
        raise RecordError(
            f"{reader.path}: the size of the frames is missing; the record was not made by rig run"
        )
    return int(frame["height_px"]), int(frame["width_px"])


def u_of_host_rate(reader: RecordReader) -> tuple[float, bool]:
    """Relative standard uncertainty of the second of the computer that made a record, and whether its clock
    followed a time server all the while.
    """
    anchors = reader.table(CLOCK.topic)
    synchronised = len(anchors) > 0 and bool(np.all(anchors["synchronised"]))
    return U_SYNCHRONISED if synchronised else U_FREE_RUNNING, synchronised


def recorded_configuration(reader: RecordReader, overrides: Sequence[str] = ()) -> Configuration:
    """The configuration that a record was made with, with ``KEY=VALUE`` overrides applied."""
    attachment = reader.attachments.get(CONFIGURATION_NAME)
    if attachment is None:
        if CONFIGURATION_NAME in reader.numbers.attachments or reader.numbers.damages:
            raise RecordError(
                f"{reader.path}: its configuration is damaged and no copy is intact, so the settings "
                "of the measurement are unknown; restore the record from a backup"
            )
        raise RecordError(f"{reader.path}: contains no configuration; it was not made by rig run")
    try:
        tree = without_schema(json.loads(attachment), f"{reader.path}: its configuration")
        config = Configuration.model_validate(tree)
    except ConfigurationError as error:
        raise RecordError(str(error)) from None
    except ValidationError as error:
        reason = fault_line(Configuration, error.errors()[0])
        raise RecordError(f"{reader.path}: its configuration is of another version ({reason})") from None
    if not overrides:
        return config
    tree = config.model_dump(mode="json", exclude_none=True)
    changed = {text.partition("=")[0].strip() for text in overrides}
    if "fit.drag" in changed and "fit.drag_s" not in changed:
        # a drag by name, open or vacuum, replaces the measured value
        for key in ("drag_s", "u_drag_s"):
            tree["fit"].pop(key, None)
    apply_overrides(tree, overrides)
    return validate_configuration(tree, str(reader.path), overrides)


_SIDE_PX, _SIGMA_PX = 64, 4.0
_COMPILING = "compiling the numerical kernels (half a minute, or some minutes on a small or busy machine"


def prepare_kernels(sensor: SensorModel, say: Callable[[str], None]) -> None:
    """Compile the kernels by tracking a synthetic spot and detecting synthetic half-cycles once.

    This takes half a minute after an installation, and less than a second afterwards (from the cache). `say`
    is called with a line if something is compiled.
    """

    def announce(is_cached: bool) -> None:
        uncached = "at every start: no cache can be written; NUMBA_CACHE_DIR can name one"
        say(f"{_COMPILING}), {'only once after an installation' if is_cached else uncached}")

    with notify_of_compilation(announce):
        compile_tracker(sensor)
        swings.compile_kernels()


@functools.cache
def compile_tracker(sensor: SensorModel) -> None:
    """Compile, or load from the cache, the kernels that track and record a spot of this sensor.

    Two frames of the camera's pixel type are tracked, one by searching, one by following; one is encoded.
    """
    # a fit, which needs the rest of this module, writes no record
    from acquisition.record.writer import encode_window

    y, x = np.mgrid[0:_SIDE_PX, 0:_SIDE_PX] - 0.5 * (_SIDE_PX - 1)
    spot = 0.5 * sensor.full_scale_dn * np.exp(-0.5 * (x**2 + y**2) / _SIGMA_PX**2)
    image = spot.astype(np.uint8 if sensor.full_scale_dn <= np.iinfo(np.uint8).max else np.uint16)
    tracker = SpotTracker(sensor)
    for _ in range(2):
        spot = tracker.track(image)
    encode_window(0, 0, image, 0, 0, spot)
    spots.compile_kernels(sensor.pixel_noise)
