"""Messages of the types defined by Foxglove, which viewers can display: log lines and the sensor's
geometry.
"""

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap_protobuf.schema import build_file_descriptor_set

from acquisition.record.topics import CAMERA_TOPIC, IMAGE_TOPIC, LOG_TOPIC, SENSOR_FRAME, RecordedLog


def foxglove_topics() -> list[tuple[str, str, bytes]]:
    """Topic, name of the schema and its descriptor, of each topic with a Foxglove type."""
    return [
        (topic, message.DESCRIPTOR.full_name, build_file_descriptor_set(message).SerializeToString())
        for topic, message in ((IMAGE_TOPIC, RawImage), (LOG_TOPIC, Log), (CAMERA_TOPIC, CameraCalibration))
    ]


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
