"""The record file of one run: its path, and the attachments stored with the measurement."""

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.camera import Camera, HasFeatures
from acquisition.frame import Frame
from acquisition.record import pixels_beside
from acquisition.record.writer import RecordWriter
from processing.errors import DeviceError
from rig.devices import OpenCamera
from rig.instrument import Optics, configuration_attachments, session_metadata
from rig.presentation import Verdict, table_tree
from rig.settings import Configuration

_log = logging.getLogger(__name__)


def features_json(camera: Camera) -> bytes:
    """All features of the camera that can be read now, as JSON; empty for a camera that has none."""
    if not isinstance(camera, HasFeatures):
        return b""
    try:
        return json.dumps(camera.feature_values(), indent=1).encode()
    except DeviceError as refused:
        _log.warning("the camera's features cannot be read for the record: %s", refused)
        return b""


@dataclass(frozen=True, slots=True)
class RecordFile:
    """A record to be written; `source` is the user's configuration file, which is attached unchanged."""

    path: Path
    config: Configuration
    source: Path
    camera: OpenCamera
    optics: Optics

    def open(self, epoch_offset_ns: int, first: Frame, preflight: Sequence[Verdict]) -> RecordWriter:
        """Create the file with configuration, provenance and preflight table.

        `epoch_offset_ns` is UTC minus the time of the frames' clock.
        """
        attachments = configuration_attachments(self.config, self.source)
        if features := features_json(self.camera.camera):
            attachments["camera-features-start.json"] = features
        if preflight:
            attachments["preflight.json"] = json.dumps(table_tree(preflight), indent=1).encode()
        lever = self.optics.lever
        writer = RecordWriter(
            self.path,
            epoch_offset_ns,
            metadata=session_metadata(self.config, self.camera.info, first)
            | {"camera_settings": self._camera_settings()},
            attachments=attachments,
            deflection_unit=self.optics.unit,
        )
        if lever is not None:
            shape = (first.image.shape[0], first.image.shape[1])
            distance_px = lever.arm_m / lever.pixel_pitch_m
            reference_px = self.optics.deflector(shape).reference_px
            writer.write_camera_calibration(first.time_ns, shape, distance_px, reference_px)
        return writer

    def _camera_settings(self) -> dict[str, str]:
        """Settings of the camera as read back, and what was added to its timestamps."""
        applied = self.camera.applied.model_dump(exclude_none=True)
        return {key: str(value) for key, value in applied.items()} | {
            "stamped": self.config.camera.stamped or self.camera.info.stamped,
            "time_shift_ns": str(self.camera.time_shift_ns),
        }

    def set_aside(self, attempt: int) -> Path:
        """Rename the record of a rejected start; returns its new path."""
        aside = self.path.with_name(f"{self.path.stem}-start-{attempt}{self.path.suffix}")
        self.path.rename(aside)
        if pixels_beside(self.path).exists():
            pixels_beside(self.path).rename(pixels_beside(aside))
        return aside
