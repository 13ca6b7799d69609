"""Pixels as messages: windows around the spot in a type of this program, whole frames as
foxglove.RawImage.
"""

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from acquisition.frame import Frame, Image
from acquisition.record.schemas import MessageType, length_delimited
from acquisition.record.topics import SENSOR_FRAME, WINDOW, RecordedWindow


def encode_window(sequence: int, time_ns: int, image: Image, x0_px: int, y0_px: int) -> bytes:
    """Message of type `WINDOW` with an image (ny, nx); (x0, y0) is the position of its first pixel on the
    sensor.
    """
    height, width = image.shape
    planes = int(image.itemsize == 2)
    if planes:
        # high bytes vary little from pixel to pixel: stored apart from the low bytes they compress well
        little_endian = np.ascontiguousarray(image, dtype="<u2")
        pixels = little_endian.view(np.uint8).reshape(-1, 2).T.tobytes()
    else:
        pixels = image.tobytes()
    return WINDOW.encode(sequence, time_ns, x0_px, y0_px, width, height, image.itemsize, planes, pixels)


def decode_window(kind: MessageType, data: bytes) -> RecordedWindow:
    """Window from a message of the type `kind`. Raises ValueError if the number of pixels is wrong."""
    field = dict(zip(kind.names, kind.decode(data), strict=True))
    shape = (field["height_px"], field["width_px"])
    pixels = np.frombuffer(field["pixels"], dtype=np.uint8)
    image: Image
    if field["bytes_per_pixel"] == 1:
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
