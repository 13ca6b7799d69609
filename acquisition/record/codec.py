"""Encoding of values as messages, and decoding: pixels, spots, half-cycles, balances, Foxglove's types.

Windows around the spot and whole frames are both compressed without loss.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import zstandard
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap_protobuf.schema import build_file_descriptor_set
from numpy.typing import NDArray

from acquisition.camera import Image
from acquisition.record.schemas import MessageType
from acquisition.record.topics import (
    CAMERA_TOPIC,
    DEFLECTION_FIELDS,
    LOG_TOPIC,
    PREVIEW_TOPIC,
    SENSOR_FRAME,
    SWING,
    WINDOW,
    RecordedWindow,
)
from acquisition.record.window_residual import IntegerGaussian, from_planes, spot_model, to_planes
from processing.balance import Balance, names_with_units
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD

_ZSTD_LEVEL = 1
_LARGE_BYTES = 64 * 1024
"""Size from which on an image is compressed by itself, which is faster than in a chunk of small messages."""
_NO_MODEL = IntegerGaussian(0, 0, 0, 0, 0, 0)


def encode_window(
    sequence: int, time_ns: int, image: Image, x0_px: int, y0_px: int, spot: Spot | None = None
) -> bytes:
    """Message of type `WINDOW` with an image (ny, nx); (x0, y0) is its first pixel on the sensor.

    With the fitted `spot` the pixels minus a model of it are stored, without loss, in about half the bytes.
    """
    height, width = image.shape
    large = image.nbytes >= _LARGE_BYTES
    model, count = None if spot is None else spot_model(spot, x0_px, y0_px, (height, width)), 0
    if model is not None:
        count, planes = to_planes(image, model)
    if model is None or count >= 8 * image.itemsize:
        model, count = _NO_MODEL, 0
        pixels = np.ascontiguousarray(image, dtype=f"<u{image.itemsize}").view(np.uint8)
        # high bytes vary little from pixel to pixel: stored apart from the low bytes they compress well
        planes = pixels.reshape(-1, image.itemsize).T.tobytes()
    if large:
        planes = zstandard.compress(planes, _ZSTD_LEVEL)
    head = (sequence, time_ns, x0_px, y0_px, width, height, image.itemsize, int(large))
    return WINDOW.encode(*head, *model, count, planes)


def decode_window(kind: MessageType, data: bytes) -> RecordedWindow:
    """Window from a message of the type `kind`. Raises ValueError if the number of pixels is wrong."""
    field = dict(zip(kind.names, kind.decode(data), strict=True))
    shape, size = (field["height_px"], field["width_px"]), field["bytes_per_pixel"]
    modelled = bool(field["model_inverse_x"])
    expected_bytes = (
        field["bit_planes"] * ((shape[0] * shape[1] + 7) // 8) if modelled else shape[0] * shape[1] * size
    )
    pixels = field["pixels"]
    pixels_bytes = zstandard.get_frame_parameters(pixels).content_size if field["compressed"] else len(pixels)
    if pixels_bytes != expected_bytes:
        raise ValueError(f"{kind.full_name}: its pixels are not {shape[1]} x {shape[0]}")
    pixels = zstandard.decompress(pixels) if field["compressed"] else pixels
    image: Image
    if modelled:
        model = IntegerGaussian(*(field[f"model_{name}"] for name in IntegerGaussian._fields))
        image = from_planes(pixels, field["bit_planes"], model, shape, size)
    else:
        planes = np.frombuffer(pixels, dtype=np.uint8).reshape(size, -1)
        image = np.ascontiguousarray(planes.T).view(f"<u{size}").reshape(shape)
    image.flags.writeable = False
    return RecordedWindow(field["sequence"], field["time_ns"], image, (field["x0_px"], field["y0_px"]))


def encode_spots(
    kind: MessageType,
    sequences: Sequence[int],
    device_times_ns: Sequence[int],
    host_times_ns: Sequence[int],
    spots: Sequence[Spot],
    deflections: Deflections,
) -> Iterator[bytes]:
    """Messages of type `SPOT` or `SPOT_UNCALIBRATED` (the unit of the deflections), one for each frame."""
    columns = [deflections.x, deflections.y, deflections.u_x, deflections.u_y]
    if deflections.unit is DeflectionUnit.RAD:
        columns += [deflections.x / ARCSEC_RAD, deflections.y / ARCSEC_RAD]
    times = sequences, deflections.times_ns.tolist(), device_times_ns, host_times_ns
    angles = zip(*columns, strict=True)
    return (
        kind.encode(*numbers, *spot, *angle)
        for *numbers, spot, angle in zip(*times, spots, angles, strict=True)
    )


def deflections_of(spots: NDArray[Any], unit: DeflectionUnit) -> Deflections:
    """The deflections in a table of spots."""
    # copies, so that the deflections do not keep the whole table in memory
    x, y, u_x, u_y = (np.array(spots[name], dtype=np.float64) for name in DEFLECTION_FIELDS[unit])
    return Deflections(np.array(spots["time_ns"], dtype=np.int64), x, y, u_x, u_y, unit)


def encode_swing(kind: MessageType, half_cycle: HalfCycle) -> bytes:
    """Message of type `SWING` or `SWING_UNCALIBRATED`."""
    display_values = [2.0 * half_cycle.half_period_s]
    if kind is SWING:
        display_values.insert(0, half_cycle.amplitude / ARCSEC_RAD)
    return kind.encode(
        *[getattr(half_cycle, name) for name in HalfCycle.__dataclass_fields__], *display_values
    )


def swings_of(table: NDArray[Any]) -> list[HalfCycle]:
    """Half-cycles from a record's table, whose first fields are those of `HalfCycle` in order."""
    return [HalfCycle(*row[: len(HalfCycle.__dataclass_fields__)]) for row in table.tolist()]


def encode_balance(kind: MessageType, balance: Balance) -> bytes:
    """Message of type `BALANCE` or `BALANCE_UNCALIBRATED`, depending on the balance's unit."""
    return kind.encode(*[getattr(balance, name) for name in names_with_units(balance.unit)])


def balances_of(table: NDArray[Any], unit: DeflectionUnit) -> list[Balance]:
    """Balances from a record's table."""
    names = names_with_units(unit)
    return [
        Balance(**{name: row[key] for name, key in names.items()}, unit=unit)
        for row in (dict(zip(table.dtype.names or (), row, strict=True)) for row in table.tolist())
    ]


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
    """Preview of an image (ny, nx), as an encoded foxglove.CompressedImage: JPEG, 8 bits, reduced in size."""
    step = preview_step((image.shape[0], image.shape[1]))
    small = image[::step, ::step]
    if image.itemsize > 1:
        small = np.minimum(small * (255.0 / full_scale_dn), 255.0).astype(np.uint8)
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(small))
    message = CompressedImage(format="jpeg", data=data.tobytes(), frame_id=SENSOR_FRAME)
    message.timestamp.FromNanoseconds(utc_ns)
    return message.SerializeToString()


def decode_preview(data: bytes) -> bytes:
    """The JPEG of a preview; see `encode_preview`."""
    return bytes(CompressedImage.FromString(data).data)


def preview_step(shape: tuple[int, int]) -> int:
    """Whole number by which an image (ny, nx) is reduced for its preview."""
    return -(-max(shape) // _PREVIEW_PX)


def encode_log(utc_ns: int, level: int, source: str, text: str) -> bytes:
    """Encoded foxglove.Log; `level` from 1 (debug) to 5 (fatal)."""
    message = Log(level=level, message=text, name=source)  # type: ignore[arg-type]
    message.timestamp.FromNanoseconds(utc_ns)
    return message.SerializeToString()
