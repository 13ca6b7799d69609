"""Messages of the types defined by Foxglove, which viewers can display: log lines, the sensor's geometry,
small pictures.
"""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap_protobuf.schema import build_file_descriptor_set

from acquisition.frame import Image
from acquisition.record.topics import CAMERA_TOPIC, LOG_TOPIC, PREVIEW_TOPIC, SENSOR_FRAME, RecordedLog

_PREVIEW_PX = 480
"""Longest side of a preview; larger images are reduced by a whole number."""
_MESSAGES: Mapping[str, Any] = {
    LOG_TOPIC: Log,
    CAMERA_TOPIC: CameraCalibration,
    PREVIEW_TOPIC: CompressedImage,
}


def foxglove_schema(topic: str) -> tuple[str, bytes]:
    """Name of the schema of a topic with a Foxglove type, and its descriptor."""
    message = _MESSAGES[topic]
    return message.DESCRIPTOR.full_name, build_file_descriptor_set(message).SerializeToString()


def encode_preview(utc_ns: int, image: Image, full_scale_dn: int) -> bytes:
    """Encoded foxglove.CompressedImage of an image (ny, nx), for the eye: 8 bits, small, JPEG."""
    step = preview_step((image.shape[0], image.shape[1]))
    small = image[::step, ::step]
    if image.itemsize > 1:
        small = np.minimum(small * (255.0 / full_scale_dn), 255.0).astype(np.uint8)
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(small))
    message = CompressedImage(format="jpeg", data=data.tobytes(), frame_id=SENSOR_FRAME)
    message.timestamp.FromNanoseconds(utc_ns)
    return message.SerializeToString()


def decode_preview(data: bytes) -> bytes:
    """The JPEG of a small picture; see `encode_preview`."""
    return bytes(CompressedImage.FromString(data).data)


def preview_step(shape: tuple[int, int]) -> int:
    """By which whole number an image (ny, nx) is reduced for its small picture."""
    return -(-max(shape) // _PREVIEW_PX)


def encode_log(utc_ns: int, level: int, source: str, text: str) -> bytes:
    """Encoded foxglove.Log; `level` from 1 (debug) to 5 (fatal)."""
    message = Log(level=level, message=text, name=source)  # type: ignore[arg-type]
    message.timestamp.FromNanoseconds(utc_ns)
    return message.SerializeToString()


def decode_log(time_ns: int, data: bytes) -> RecordedLog:
    """Line of the log from a foxglove.Log; `time_ns` is its time on the frames' clock."""
    line = Log.FromString(data)
    return RecordedLog(time_ns, line.level, line.name, line.message)


def encode_camera_calibration(
    utc_ns: int, sensor_shape: tuple[int, int], distance_px: float, reference_px: tuple[float, float]
) -> bytes:
    """Encoded foxglove.CameraCalibration without distortion; see `RecordWriter.write_camera_calibration`."""
    x_px, y_px = reference_px
    message = CameraCalibration(
        frame_id=SENSOR_FRAME,
        width=sensor_shape[1],
        height=sensor_shape[0],
        K=[distance_px, 0.0, x_px, 0.0, distance_px, y_px, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[distance_px, 0.0, x_px, 0.0, 0.0, distance_px, y_px, 0.0, 0.0, 0.0, 1.0, 0.0],
    )
    message.timestamp.FromNanoseconds(utc_ns)
    return message.SerializeToString()
