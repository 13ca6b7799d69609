"""Provenance of a record (configuration, software versions, host), written to it and read back."""

import functools
import hashlib
import importlib.metadata
import json
import platform
import socket
import subprocess
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from acquisition.camera import CameraInfo
from acquisition.frame import Frame
from acquisition.record.reader import RecordReader
from acquisition.record.recorded_camera import camera_metadata
from processing.errors import ConfigurationError, RecordError
from rig.instrument.calibration import calibration_attachments
from rig.settings import (
    Configuration,
    apply_overrides,
    in_words,
    stored_configuration,
    unnumbered,
    validate_configuration,
)

CONFIGURATION_NAME = "configuration.json"
SOURCE_NAME = "configuration.toml"
RECORD_DESCRIPTION = "record.md"
_INPUTS = ("configuration.", "calibration/")
_ROOT = Path(__file__).resolve().parents[2]
_OF_NUMBERS = ("numpy", "scipy", "numba", "opencv-python-headless")
_PACKAGES = ("optical-pendulum-rig", *_OF_NUMBERS, "mcap", "rerun-sdk")


def versions() -> dict[str, str]:
    """Versions of this program and of the libraries that influence the numbers."""
    found = {"python": platform.python_version(), "platform": platform.platform(), "commit": code_commit()}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


@functools.cache
def code_identity() -> str:
    """For example `0.1.0 (394556fc) 5f1c0e9d0a7b3c24`; equal where the same sources would run.

    The commit alone does not say it: a checkout may be changed, an installation has none.
    """
    digest = hashlib.sha256()
    for package in ("rig", "acquisition", "calibration", "processing"):
        for path in sorted((_ROOT / package).rglob("*.py")):
            digest.update(f"{path.relative_to(_ROOT).as_posix()}\0".encode() + path.read_bytes())
    known = versions()
    digest.update("".join(f"{name} {known[name]}\n" for name in _OF_NUMBERS).encode())
    return f"{known[_PACKAGES[0]]} ({known['commit'][:8]}) {digest.hexdigest()[:16]}"


@functools.cache
def code_commit() -> str:
    """The commit of this code: of the checkout it runs from, with "changed" where files differ from it, or
    of what was installed; "unknown" otherwise.
    """
    try:
        done = subprocess.run(
            [
                "git",
                "-C",
                str(_ROOT),
                "describe",
                "--always",
                "--abbrev=40",
                "--dirty=, changed",
                "--exclude=*",
            ],
            capture_output=True,
            text=True,
            encoding="utf-8",
            timeout=5.0,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        if done.returncode == 0 and (_ROOT / ".git").exists():
            return done.stdout.strip()
        origin = importlib.metadata.distribution(_PACKAGES[0]).read_text("direct_url.json")
        return str(json.loads(origin or "{}")["vcs_info"]["commit_id"])
    except (
        OSError,
        subprocess.SubprocessError,
        ValueError,
        KeyError,
        importlib.metadata.PackageNotFoundError,
    ):
        return "unknown"


def record_description() -> bytes:
    """How a record is to be read, for who has nothing else; empty where the installation lacks it."""
    for path in (_ROOT / "docs" / "reference" / RECORD_DESCRIPTION, _ROOT / "rig" / RECORD_DESCRIPTION):
        if path.is_file():
            return path.read_bytes()
    return b""


def session_metadata(config: Configuration, info: CameraInfo, first: Frame) -> dict[str, dict[str, str]]:
    """Metadata of a record, by section: session, conditions, camera, software versions, shape of frames."""
    session = config.session
    environment = config.environment.model_dump(exclude_none=True)
    return {
        "session": {
            "operator": session.operator,
            "sample": session.sample,
            "contact_history": session.contact_history,
            **{
                name: at.isoformat()
                for name, at in (
                    ("contact_made", session.contact_made),
                    ("surfaces_cleaned", session.surfaces_cleaned),
                )
                if at is not None
            },
            "notes": session.notes,
            "host": socket.gethostname(),
        },
        "environment": {key: f"{value:g}" for key, value in environment.items()},
        **camera_metadata(info),
        "frame": {"width_px": str(first.image.shape[1]), "height_px": str(first.image.shape[0])},
        "versions": versions(),
    }


def configuration_attachments(config: Configuration, source: Path) -> dict[str, bytes]:
    """Files to attach to a record: the complete configuration, the user's original file, calibrations."""
    attachments = {CONFIGURATION_NAME: _stored(config)}
    if source.is_file() and source.suffix == ".toml":
        attachments[SOURCE_NAME] = source.read_bytes()
    description = record_description()
    if description:
        attachments[RECORD_DESCRIPTION] = description
    return {**attachments, **calibration_attachments(config)}


def _stored(config: Configuration) -> bytes:
    return json.dumps(stored_configuration(config), indent=1, ensure_ascii=False).encode()


def inputs_sha256(reader: RecordReader) -> dict[str, str]:
    """SHA-256 of the configuration and of every calibration in a record, by name, as read and verified."""
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


def recorded_configuration(reader: RecordReader, overrides: Sequence[str] = ()) -> Configuration:
    """The configuration that a record was made with, with ``KEY=VALUE`` overrides applied."""
    attachment = reader.attachments.get(CONFIGURATION_NAME)
    if attachment is None:
        if CONFIGURATION_NAME in reader.contents.attachment_places or reader.contents.damage:
            raise RecordError(
                f"{reader.path}: its configuration is damaged and no copy is intact, so the settings "
                "of the measurement are unknown; restore the record from a backup"
            )
        raise RecordError(f"{reader.path}: contains no configuration; it was not made by rig run")
    try:
        tree = unnumbered(json.loads(attachment), f"{reader.path}: its configuration")
        config = Configuration.model_validate(tree)
    except ConfigurationError as error:
        raise RecordError(str(error)) from None
    except ValidationError as error:
        said = in_words(Configuration, error.errors()[0])
        raise RecordError(f"{reader.path}: its configuration is of another version ({said})") from None
    if not overrides:
        return config
    tree = config.model_dump(mode="json", exclude_none=True)
    changed = {text.partition("=")[0].strip() for text in overrides}
    if "fit.drag" in changed and "fit.drag_s" not in changed:
        # open or vacuum by name is in the place of a value that was measured
        for key in ("drag_s", "u_drag_s"):
            tree["fit"].pop(key, None)
    apply_overrides(tree, overrides)
    return validate_configuration(tree, str(reader.path), overrides)
