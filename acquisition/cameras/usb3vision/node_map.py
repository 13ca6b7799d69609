"""The features of a camera by name: EMVA's GenApi, with the camera's own description and registers.

The description (GenICam XML) is located by the manifest, unzipped and decoded.
"""

import io
import re
import struct
import threading
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from acquisition.camera import CameraLost, FeatureValue, PixelFormat
from acquisition.cameras.genicam import GenicamFeatures
from acquisition.cameras.genicam_access import Aliases
from acquisition.cameras.usb3vision.gencp import GenCpChannel
from processing.errors import DeviceError, optional_module

ACCESS: Final = (
    "not implemented",
    "not available at present",
    "write-only",
    "read-only",
    "readable and writable",
)
"""Possible access to a feature, indexed by the numbers of GenApi's access modes."""
NOT_IMPLEMENTED, _, WRITE_ONLY, READ_ONLY, READ_WRITE = ACCESS
_PORT: Final = "Device"
_NUMBERS: Final = ("Integer", "Float")
_VALUES: Final = (*_NUMBERS, "Boolean", "Enumeration", "String")
_NO_LIMIT: Final = 1e300
"""A limit beyond this means "no limit"."""
_SWITCH: Final = {"true": True, "on": True, "1": True, "false": False, "off": False, "0": False}
_SOURCE_LINE: Final = re.compile(r"\s*: \w+Exception thrown.*", re.DOTALL)
"""End of a GenApi message, which names the line of GenApi's source code."""


@dataclass(frozen=True, slots=True)
class FeatureReading:
    """One feature for display; `value` is None if it cannot be read, for the reason in `problem`."""

    name: str
    kind: str
    access: str = ""
    value: FeatureValue | bytes | None = None
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    choices: tuple[str, ...] = ()
    problem: str = ""


def load_genapi() -> Any:
    """The module of EMVA's GenApi. Raises MissingPackage if it is not installed."""
    return optional_module("genicam.genapi", "camera.driver = 'usb3vision'", "genicam", "usb3vision")


class NodeMap(GenicamFeatures):
    """The features of a camera by name, with a cache of its registers.

    Methods raise DeviceError for a feature that the camera does not have, or that cannot be read or set;
    errors of the registers are passed on.

    Parameters
    ----------
    xml
        The camera's description.
    channel
        Access to its registers.
    name
        Name of the camera in messages.
    """

    ALIASES: ClassVar[Aliases] = GenicamFeatures.ALIASES | {
        "ExposureTime": ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw"),
        "Gain": ("Gain", "GainAbs", "GainRaw"),
    }

    def __init__(self, xml: str, channel: GenCpChannel, name: str) -> None:
        super().__init__(name)
        self._genapi = genapi = load_genapi()
        # GenApi keeps Python's lock while it waits for its own, so two threads in it would wait for ever
        self._lock = threading.RLock()
        self._nodes = genapi.NodeMap()

        class Port(genapi.AbstractPort):  # type: ignore[name-defined, misc]
            """The camera's registers, whose addresses GenApi passes as signed numbers."""

            def read(self, address: int, length: int) -> bytes:
                return channel.read(address % (1 << 64), length)

            def write(self, address: int, data: Any) -> None:
                channel.write(address % (1 << 64), bytes(data))

            def get_access_mode(self) -> Any:
                return genapi.EAccessMode.RW

        with self._locked("the camera's description is not valid"):
            # the text is already decoded: the parser would fail on a declaration of another encoding
            self._nodes.load_xml_from_string(re.sub(r"^\s*<\?xml[^>]*\?>", "", xml, count=1))
            if not self._nodes.connect(Port(), _PORT):
                raise DeviceError(f"{name}: the camera's description is not valid: it has no port {_PORT!r}")

    def has(self, feature: str) -> bool:
        with self._lock:
            return bool(self._nodes.has_node(feature))

    def access(self, name: str) -> str:
        """Possible access to a feature at present, one of `ACCESS`; the camera need not have the feature."""
        with self._locked(f"{name} cannot be read"):
            return ACCESS[self._node(name).get_access_mode()] if self.has(name) else NOT_IMPLEMENTED

    def readable(self, name: str) -> bool:
        """Whether the camera has the feature and it can be read at present."""
        return self.access(name) in (READ_ONLY, READ_WRITE)

    def writable(self, feature: str) -> bool:
        return self.access(feature) in (WRITE_ONLY, READ_WRITE)

    def kind(self, name: str) -> str:
        """Kind of a feature by its interface: "Integer", "Float", "Command" and so on."""
        return type(self._node(name)).__name__.removeprefix("I")

    def choices(self, feature: str) -> tuple[str, ...]:
        with self._locked(f"{feature} cannot be read"):
            return tuple(getattr(self._node(feature), "symbolics", ())) if self.has(feature) else ()

    def limits(self, feature: str) -> tuple[float | None, float | None]:
        if self.kind(feature) not in _NUMBERS or not self.readable(feature):
            return None, None
        with self._locked(f"{feature} cannot be read"):
            low, high = self._node(feature).min, self._node(feature).max
            return (low if low > -_NO_LIMIT else None), (high if high < _NO_LIMIT else None)

    def read(self, feature: str) -> FeatureValue | None:
        value = self.get(feature) if self.readable(feature) else None
        return value if value is None or isinstance(value, bool | int | float | str) else str(value)

    def get(self, name: str) -> Any:
        """Value of a feature: int, float, bool, bytes (a register), or str (a text or a choice).

        The value of a command is True while the camera executes it.
        """
        with self._locked(f"{name} cannot be read"):
            node, kind = self._node(name), self.kind(name)
            if not self.readable(name):
                raise DeviceError(f"{self.name}: {name} cannot be read: it is {self.access(name)}")
            if kind == "Register":
                return bytes(node.get(node.length))
            if kind == "Command":
                return not node.is_done()
            if kind not in _VALUES:
                raise DeviceError(f"{self.name}: {name} is a {kind} and has no value")
            return node.value

    def write(self, feature: str, value: FeatureValue) -> None:
        """Set a feature to a value, or to a value's text; a command is run by any value."""
        with self._locked(f"{feature} cannot be set to {value!r}"):
            node, kind = self._node(feature), self.kind(feature)
            if not self.writable(feature):
                raise DeviceError(f"{self.name}: {feature} cannot be set: it is {self.access(feature)}")
            if kind == "Command":
                node.execute()
            elif kind in _VALUES:
                node.value = self._allowed(feature, value)
            else:
                raise DeviceError(f"{self.name}: {feature} is a {kind} and cannot be set")

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        return {
            reading.name: reading.value.hex() if isinstance(reading.value, bytes) else reading.value
            for reading in self.readings()
            if reading.value is not None and not reading.problem and reading.kind != "Command"
        }

    def free_rate_hz(self) -> float | None:
        return self.expected_rate_hz() if self.number("frame_rate_hz") else None

    def max_rate_hz(self) -> float | None:
        feature = self.local_name("AcquisitionFrameRate")
        return super().max_rate_hz() or (self.limits(feature)[1] if self.has(feature) else None)

    def set_format(self, depth: PixelFormat | None) -> None:
        # a mosaic that is set is not replaced by pixels that the camera computes from it, but refused
        if depth is not None or self.plane:
            super().set_format(depth)

    def renew(self) -> None:
        with self._lock:
            self._node(_PORT).node.invalidate_node()

    def readings(self) -> Iterator[FeatureReading]:
        """All implemented features of the camera and their present values; faulty ones have a `problem`."""
        self.renew()
        for name in dict.fromkeys(self._names_in("Root")):
            try:
                kind, access = self.kind(name), self.access(name)
                value = self.get(name) if access in (READ_ONLY, READ_WRITE) else None
                unit = self._node(name).unit if kind in _NUMBERS else ""
                choices = self.choices(name) if access != NOT_IMPLEMENTED else ()
                reading = FeatureReading(name, kind, access, value, *self.limits(name), unit, choices)
            except CameraLost:
                raise
            except DeviceError as error:
                reading = FeatureReading(name, self.kind(name), problem=str(error))
            if reading.access != NOT_IMPLEMENTED:
                yield reading

    # ---- inside

    def _node(self, name: str) -> Any:
        if not self.has(name):
            raise DeviceError(f"{self.name}: has no feature {name!r}")
        with self._lock:
            return self._nodes.get_node(name)

    def _names_in(self, category: str) -> list[str]:
        """Names of the features in a category and in those below it."""
        with self._lock:
            names = [feature.node.name for feature in self._node(category).features]
        nested = (self._names_in(name) if self.kind(name) == "Category" else [name] for name in names)
        return [name for names in nested for name in names]

    def _allowed(self, name: str, value: Any) -> Any:
        """The value in the feature's type; DeviceError, with the allowed values, if it is not allowed."""
        node, kind, assignment = self._node(name), self.kind(name), f"{self.name}: {name} = {value}"
        if kind == "Enumeration" and value not in node.symbolics:
            listed = ", ".join(node.symbolics)
            raise DeviceError(f"{self.name}: {name} cannot be {value!r} at present; choices: {listed}")
        if kind == "Boolean":
            if str(value).lower() not in _SWITCH:
                raise DeviceError(f"{assignment} must be true or false")
            return _SWITCH[str(value).lower()]
        if kind not in _NUMBERS:
            return str(value)
        try:
            number = _number(value) if isinstance(value, str) else value
        except ValueError:
            raise DeviceError(f"{self.name}: {name} = {value!r} is not a number") from None
        is_integer = kind == "Integer"
        if is_integer and number % 1 != 0:
            raise DeviceError(f"{assignment} must be a whole number")
        low, high, step = node.min, node.max, (node.inc if is_integer or node.has_inc() else 1) or 1
        if not low <= number <= high or (is_integer and (number - low) % step):
            unit, steps = f" {node.unit}".rstrip(), f" in steps of {step:g}" if step != 1 else ""
            span = f"{low:.10g} to {high:.10g}{unit}{steps}"
            raise DeviceError(f"{assignment} is out of range; allowed is {span}")
        return int(number) if is_integer else float(number)

    @contextmanager
    def _locked(self, problem: str) -> Iterator[None]:
        """Hold the lock, and convert GenApi's errors into a DeviceError that begins with `problem`."""
        with self._lock:
            try:
                yield
            except (self._genapi.GenericException, UnicodeDecodeError, RuntimeError) as failure:
                reason = re.sub(r"\s+", " ", _SOURCE_LINE.sub("", str(failure))).strip()
                raise DeviceError(f"{self.name}: {problem}: {reason}") from failure


def _number(text: str) -> int | float:
    try:
        return int(text, 0)
    except ValueError:
        return float(text)


_COUNT: Final = struct.Struct("<Q")
_ENTRY: Final = struct.Struct("<HBBIQQ")  # file's sub-minor, minor, major version, schema, address, size
_ENTRY_STRIDE: Final = 64
_MAX_ENTRIES: Final = 64
_MAX_FILE_BYTES: Final = 64 << 20
"""A larger description means a damaged manifest; real ones are below 1 MB, zipped below 100 kB."""
_PLAIN_OR_ZIPPED: Final = (0, 1)


def read_description(channel: GenCpChannel, address: int, name: str) -> str:
    """The newest description in the camera's manifest, as text that begins with its first tag.

    Raises DeviceError where the manifest, the archive or the text is damaged.
    """
    (count,) = _COUNT.unpack(channel.read(address, _COUNT.size))
    if not 0 < count <= _MAX_ENTRIES:
        raise DeviceError(f"{name}: its manifest lists {count} descriptions, 1 to {_MAX_ENTRIES} are valid")
    entries: list[tuple[tuple[int, int, int], int, int]] = []
    for index in range(count):
        raw = channel.read(address + _COUNT.size + index * _ENTRY_STRIDE, _ENTRY.size)
        subminor, minor, major, schema, file_address, size = _ENTRY.unpack(raw)
        if (schema >> 10) & 31 in _PLAIN_OR_ZIPPED:
            entries.append(((major, minor, subminor), file_address, size))
    if not entries:
        raise DeviceError(f"{name}: its manifest has no description that is plain or zipped XML")
    _, file_address, size = max(entries)
    if not 0 < size <= _MAX_FILE_BYTES:
        raise DeviceError(f"{name}: its manifest gives the description {size} bytes: the manifest is damaged")
    return decode_description(channel.read(file_address, size), name)


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
