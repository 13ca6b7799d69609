"""A USB Test & Measurement instrument over USB/IP, from the class's documents (USBTMC 1.0, USB488).

It answers the kernel's vhci-hcd on one end of a socket pair; what it says comes from a function.
"""

import socket
import struct
from collections.abc import Callable

HEADER = struct.Struct(">IIIII")  # command, sequence number, device, direction, endpoint
SUBMIT_BODY = struct.Struct(">IiiiI8s")  # flags, length, start frame, packets, interval, setup
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
STALLED, CANCELLED = -32, -104
BULK_OUT, BULK_IN, PACKET = 0x01, 0x82, 512
VENDOR, PRODUCT = 0x1313, 0x804A
DEV_DEP_OUT, REQUEST_IN = 1, 2
SUCCESS, NOT_IN_PROGRESS = 0x01, 0x81


class UsbTmcDevice:
    """One instrument; `answer` gets each message (text) and returns its answer, or None for none."""

    def __init__(self, connection: socket.socket, serial: str, answer: Callable[[str], str | None]) -> None:
        self._connection = connection
        self._serial = serial
        self._answer = answer
        self._said = b""
        self._asked: tuple[int, int] | None = None  # tag and room of the request that has no answer yet
        self._waiting: list[tuple[int, int]] = []  # sequence number and room of the kernel's reads

    def serve(self) -> None:
        """Until the kernel lets go, or the process is killed: the cable is pulled out."""
        while head := self._connection.recv(HEADER.size, socket.MSG_WAITALL):
            command, number, _, direction, endpoint = HEADER.unpack(head)
            body = self._connection.recv(28, socket.MSG_WAITALL)
            if command == UNLINK:
                (wanted,) = struct.unpack_from(">I", body)
                known = [read for read in self._waiting if read[0] == wanted]
                self._waiting = [read for read in self._waiting if read[0] != wanted]
                self._send(HEADER.pack(UNLINKED, number, 0, 0, 0), CANCELLED if known else 0, b"\0" * 24)
                continue
            _, length, _, _, _, setup = SUBMIT_BODY.unpack(body)
            data = self._connection.recv(length, socket.MSG_WAITALL) if not direction and length else b""
            if endpoint == 0:
                self._control(number, setup, length)
            elif direction:
                self._waiting.append((number, length))
            else:
                self._message(data)
                self._done(number, 0, len(data))
            self._give()

    def _send(self, head: bytes, status: int, rest: bytes) -> None:
        self._connection.sendall(head + struct.pack(">i", status) + rest)

    def _done(self, number: int, status: int, count: int, data: bytes = b"") -> None:
        self._send(
            HEADER.pack(SUBMITTED, number, 0, 0, 0), status, struct.pack(">iiii8x", count, 0, 0, 0) + data
        )

    def _message(self, data: bytes) -> None:
        kind, tag, inverse, _, size, _ = struct.unpack_from("<BBBBIB", data)
        assert inverse == ~tag & 0xFF
        if kind == DEV_DEP_OUT:
            assert len(data) == -(-(12 + size) // 4) * 4
            for line in data[12 : 12 + size].decode("ascii").splitlines():
                self._said = (self._answer(line.strip()) or "").encode("ascii")
        elif kind == REQUEST_IN:
            self._asked = (tag, size)

    def _give(self) -> None:
        """Answer the kernel's read once there is a request and something to say; until then it waits."""
        if not (self._said and self._asked and self._waiting):
            return
        (tag, room), (number, length) = self._asked, self._waiting.pop(0)
        part, self._said = self._said[:room], self._said[room:]
        self._asked = None
        head = struct.pack("<BBBBIB3x", REQUEST_IN, tag, ~tag & 0xFF, 0, len(part), 0 if self._said else 1)
        data = head + part + b"\0" * (-len(part) % 4)
        assert len(data) <= length
        self._done(number, 0, len(data), data)

    def _control(self, number: int, setup: bytes, length: int) -> None:
        kind, what, value, _, _ = struct.unpack("<BBHHH", setup)
        answer: bytes | None = b""
        if (kind, what) == (0x80, 6):
            answer = self._descriptor(value >> 8, value & 0xFF)
        elif (kind, what) == (0x80, 0):
            answer = b"\0\0"
        elif (kind, what) == (0xA1, 7):  # capabilities: USBTMC 1.0, USB488 1.0
            answer = struct.pack("<BBHBB6xHBB8x", SUCCESS, 0, 0x0100, 0, 0, 0x0100, 0, 0)
        elif (kind, what) == (0xA1, 5):
            self._said, self._asked = b"", None
            answer = bytes([SUCCESS])
        elif (kind, what) == (0xA1, 6):
            answer = bytes([SUCCESS, 0])
        elif (kind, what) in ((0xA2, 1), (0xA2, 3)):
            known = self._asked is not None
            self._asked = None
            answer = bytes([SUCCESS if known else NOT_IN_PROGRESS, value & 0xFF])
        elif (kind, what) in ((0xA2, 2), (0xA2, 4)):
            answer = struct.pack("<BBHI", SUCCESS, 0, 0, 0)
        elif kind & 0x80:
            answer = None
        if answer is None:
            self._done(number, STALLED, 0)
        else:
            self._done(number, 0, len(answer[:length]), answer[:length] if kind & 0x80 else b"")

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        if kind == 1:
            return struct.pack(
                "<BBHBBBBHHHBBBB", 18, 1, 0x0200, 0, 0, 0, 64, VENDOR, PRODUCT, 0x0100, 1, 2, 3, 1
            )
        if kind == 2:
            body = struct.pack("<9B", 9, 4, 0, 0, 2, 0xFE, 3, 1, 0)
            for address in (BULK_OUT, BULK_IN):
                body += struct.pack("<BBBBHB", 7, 5, address, 2, PACKET, 0)
            return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 1, 1, 0, 0xC0, 0) + body
        strings = {1: "Thorlabs", 2: "ITC4001", 3: self._serial}
        if kind == 3 and index == 0:
            return struct.pack("<BBH", 4, 3, 0x0409)
        if kind == 3 and index in strings:
            text = strings[index].encode("utf-16-le")
            return struct.pack("<BB", 2 + len(text), 3) + text
        return None
