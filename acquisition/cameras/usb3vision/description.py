"""The camera's description of its features (GenICam XML), located by the manifest, unzipped and decoded."""

import io
import struct
import zipfile
import zlib
from dataclasses import dataclass
from typing import Final

from acquisition.cameras.usb3vision.gencp import GenCpChannel
from processing.errors import DeviceError

_COUNT: Final = struct.Struct("<Q")
_ENTRY: Final = struct.Struct("<HBBIQQ")  # file's sub-minor, minor, major version, schema, address, size
_ENTRY_STRIDE: Final = 64
_MAX_ENTRIES: Final = 64
_MAX_FILE_BYTES: Final = 64 << 20
"""A larger description means a damaged manifest; real ones are below 1 MB, zipped below 100 kB."""
_PLAIN: Final = 0
_ZIPPED: Final = 1


@dataclass(frozen=True, slots=True)
class ManifestEntry:
    """Version, packing (plain or zipped), address and size in bytes of one description in the camera."""

    version: tuple[int, int, int]
    packing: int
    address: int
    size: int


def read_manifest(channel: GenCpChannel, address: int, name: str) -> tuple[ManifestEntry, ...]:
    """All descriptions in the camera, in the order of its manifest; DeviceError if the number is invalid."""
    (count,) = _COUNT.unpack(channel.read(address, _COUNT.size))
    if not 0 < count <= _MAX_ENTRIES:
        raise DeviceError(f"{name}: its manifest lists {count} descriptions, 1 to {_MAX_ENTRIES} are valid")
    entries = []
    for index in range(count):
        raw = channel.read(address + _COUNT.size + index * _ENTRY_STRIDE, _ENTRY.size)
        subminor, minor, major, schema, file_address, size = _ENTRY.unpack(raw)
        entries.append(ManifestEntry((major, minor, subminor), (schema >> 10) & 31, file_address, size))
    return tuple(entries)


def read_description(channel: GenCpChannel, address: int, name: str) -> str:
    """The newest description in the camera, as text that begins with its first tag.

    Raises
    ------
    DeviceError
        The manifest, the archive or the text is damaged.
    """
    entries = [e for e in read_manifest(channel, address, name) if e.packing in (_PLAIN, _ZIPPED)]
    if not entries:
        raise DeviceError(f"{name}: its manifest has no description that is plain or zipped XML")
    newest = max(entries, key=lambda entry: entry.version)
    if not 0 < newest.size <= _MAX_FILE_BYTES:
        raise DeviceError(
            f"{name}: its manifest gives the description {newest.size} bytes: the manifest is damaged"
        )
    return decode_description(channel.read(newest.address, newest.size), name)


def decode_description(packed: bytes, name: str) -> str:
    """Text of a description; data that begin like a zip archive are unzipped, whatever the manifest says."""
    if packed.startswith(b"PK"):
        packed = _unzip(packed, name)
    # some cameras put a line of text before the XML, or zeros after it
    start, end = packed.find(b"<"), packed.rfind(b">")
    if start < 0 or end < start:
        raise DeviceError(f"{name}: its description is not XML: it begins with {packed[:40]!r}")
    body = packed[start : end + 1]
    try:
        return body.decode("utf-8-sig")
    except UnicodeDecodeError:
        return body.decode("latin-1")  # never fails; the names of features are ASCII in any case


def _unzip(packed: bytes, name: str) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            members = [info for info in archive.infolist() if not info.is_dir()]
            if not members:
                raise DeviceError(f"{name}: the archive with its description is empty")
            return archive.read(members[0])
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as damage:
        raise DeviceError(f"{name}: the archive with its description is damaged: {damage}") from damage
