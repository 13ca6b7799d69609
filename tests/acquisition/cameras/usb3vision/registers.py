"""The memory of the test camera: bootstrap registers, manifest, description and its own features.

Written from the standard's layouts, without the driver's constants.
"""

import io
import struct
import zipfile

from tests.acquisition.cameras.usb3vision import description as layout

SBRM, SIRM, EIRM, MANIFEST, XML = 0x10000, 0x10400, 0x10800, 0x11000, 0x100000


class Registers:
    """Bytes by address; `description` is the XML, stored as ``"zip"`` or ``"plain"``."""

    def __init__(
        self,
        serial: str,
        description: bytes,
        packing: str,
        max_packet: int,
        frame_rate_hz: float,
        clock_step_ns: int,
    ) -> None:
        abrm = bytearray(0x1000)

        def put(where: bytearray, at: int, layout: str, *values: float) -> None:
            struct.pack_into("<" + layout, where, at, *values)

        put(abrm, 0x0, "HH", 0, 1)
        for at, name in (
            (0x4, "Testwerk"),
            (0x44, "Pendulum Eye"),
            (0x84, "Test family"),
            (0x144, serial),
        ):
            abrm[at : at + len(name)] = name.encode()
        put(abrm, 0x1C4, "Q", 0x8 | 0x200 | 0x800)
        put(abrm, 0x1CC, "I", 100)
        put(abrm, 0x1D0, "QQ", MANIFEST, SBRM)
        put(abrm, 0x1FC, "Q", clock_step_ns)
        sbrm = bytearray(0x100)
        put(sbrm, 0x0, "I", 0x00010000)
        put(sbrm, 0x4, "Q", 3)
        put(sbrm, 0x14, "III", max_packet, max_packet, 1)
        put(sbrm, 0x20, "QIQI", SIRM, 0x30, EIRM, 0x10)
        put(sbrm, 0x40, "I", 8)
        sirm = bytearray(0x30)
        put(sirm, 0x0, "I", 2 << 24)  # alignment to 4 bytes
        stored, schema = description, 0
        if packing == "zip":
            buffer = io.BytesIO()
            with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr("eye.xml", description)
            stored, schema = buffer.getvalue(), 1 << 10
        manifest = bytearray(8 + 64)
        put(manifest, 0, "Q", 1)
        put(manifest, 8, "HBBIQQ", 0, 0, 1, schema, XML, len(stored))
        own = bytearray(layout.END - layout.BASE)
        self._segments = {0: abrm, SBRM: sbrm, SIRM: sirm, EIRM: bytearray(0x10), MANIFEST: manifest}
        # memory is made of words, whatever is stored in it
        self._segments |= {layout.BASE: own, XML: bytearray(stored + bytes(-len(stored) % 4))}
        for at, value in (
            (layout.WIDTH, 640), (layout.HEIGHT, 480), (layout.PIXEL_FORMAT, layout.FORMATS["Mono8"]),
        ):  # fmt: skip
            self.poke(at, struct.pack("<I", value))
        self.poke(layout.EXPOSURE_TICKS, struct.pack(">I", 10000))
        self.poke(layout.FRAME_RATE, struct.pack("<d", frame_rate_hz))
        self.poke(layout.FRAME_RATE_ENABLE, b"\0\0\0\1")

    def find(self, address: int, length: int) -> tuple[bytearray, int] | None:
        """The segment that holds these addresses, and where in it; None if there is none."""
        for base, segment in self._segments.items():
            if base <= address and address + length <= base + len(segment):
                return segment, address - base
        return None

    def peek(self, address: int, length: int = 4) -> bytes:
        """Registers as they are, without a command."""
        found = self.find(address, length)
        assert found is not None, hex(address)
        return bytes(found[0][found[1] : found[1] + length])

    def poke(self, address: int, data: bytes) -> None:
        """Set registers without a command."""
        found = self.find(address, len(data))
        assert found is not None, hex(address)
        found[0][found[1] : found[1] + len(data)] = data

    def number(self, address: int) -> int:
        """A little-endian 32-bit register."""
        return int(struct.unpack("<I", self.peek(address))[0])
