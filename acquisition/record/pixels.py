"""Pixels as messages: windows around the spot in a type of this program, whole frames as
foxglove.RawImage.
"""

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from acquisition.frame import Frame, Image
from acquisition.record.schemas import MessageType, length_delimited
from acquisition.record.topics import SENSOR_FRAME, WINDOW, RecordedWindow
from acquisition.record.window_residual import IntegerGaussian, from_planes, spot_model, to_planes
from processing.spot import Spot

_NO_MODEL = IntegerGaussian(0, 0, 0, 0, 0, 0)


def encode_window(
    sequence: int, time_ns: int, image: Image, x0_px: int, y0_px: int, spot: Spot | None = None
) -> bytes:
    """Message of type `WINDOW` with an image (ny, nx); (x0, y0) is the position of its first pixel on the
    sensor.

    With the fitted `spot` the pixels minus a model of it are stored, without loss, in about half the bytes.
    """
    height, width = image.shape
    head = (sequence, time_ns, x0_px, y0_px, width, height, image.itemsize)
    model = None if spot is None else spot_model(spot, x0_px, y0_px, (height, width))
    if model is not None:
        count, pixels = to_planes(image, model)
        if count < 8 * image.itemsize:
            return WINDOW.encode(*head, 0, *model, count, pixels)
    planes = int(image.itemsize == 2)
    if planes:
        # high bytes vary little from pixel to pixel: stored apart from the low bytes they compress well
        little_endian = np.ascontiguousarray(image, dtype="<u2")
        pixels = little_endian.view(np.uint8).reshape(-1, 2).T.tobytes()
    else:
        pixels = image.tobytes()
    return WINDOW.encode(*head, planes, *_NO_MODEL, 0, pixels)


def decode_window(kind: MessageType, data: bytes) -> RecordedWindow:
    """Window from a message of the type `kind`. Raises ValueError if the number of pixels is wrong."""
    field = dict(zip(kind.names, kind.decode(data), strict=True))
    shape = (field["height_px"], field["width_px"])
    pixels = np.frombuffer(field["pixels"], dtype=np.uint8)
    image: Image
    if field["model_inverse_x"]:
        model = IntegerGaussian(*(field[f"model_{name}"] for name in IntegerGaussian._fields))
        image = from_planes(field["pixels"], field["bit_planes"], model, shape, field["bytes_per_pixel"])
    elif field["bytes_per_pixel"] == 1:
        image = pixels.reshape(shape)
    elif field["byte_planes"]:
        image = np.ascontiguousarray(pixels.reshape(2, -1).T).view("<u2").reshape(shape)
    else:
        image = pixels.view("<u2").reshape(shape)
    image.flags.writeable = False
    return RecordedWindow(field["sequence"], field["time_ns"], image, (field["x0_px"], field["y0_px"]))


def encode_image(frame: Frame, utc_ns: int) -> tuple[bytes, memoryview]:
    """foxglove.RawImage, mono8 or mono16 (little endian), in two consecutive parts.

    The pixels are the last field and are not copied: at 100 frames/s of 2.6 MB, copying would take longer
    than the compression.
    """
    kind = np.uint8 if frame.image.itemsize == 1 else np.dtype("<u2")
    image = np.ascontiguousarray(frame.image, dtype=kind)
    message = RawImage(
        width=image.shape[1],
        height=image.shape[0],
        encoding="mono8" if image.itemsize == 1 else "mono16",
        step=image.shape[1] * image.itemsize,
        frame_id=SENSOR_FRAME,
    )
    message.timestamp.FromNanoseconds(utc_ns)
    pixels = length_delimited(RawImage.DESCRIPTOR.fields_by_name["data"].number, image.nbytes)
    return message.SerializeToString() + pixels, image.data.cast("B")


def decode_image(data: bytes) -> Image:
    """Image (ny, nx) from a foxglove.RawImage made by `encode_image`."""
    raw = RawImage.FromString(data)
    dtype = np.dtype("u1" if raw.encoding == "mono8" else "<u2")
    image: Image = np.frombuffer(raw.data, dtype=dtype).reshape(raw.height, raw.width)
    return image
