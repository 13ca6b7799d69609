"""Serves a test camera over USB/IP, so that a real kernel treats it as a connected device.

Only what follows the attachment is here: the kernel's vhci-hcd is given one end of a socket pair
and asks for transfers on it; see Documentation/usb/usbip_protocol in the kernel's sources.
"""

import logging
import socket
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass, field

from tests.acquisition.cameras.usb3vision import descriptors
from tests.acquisition.cameras.usb3vision.device import (
    OverrunError,
    StalledError,
    UnpluggedError,
    VisionDevice,
)

logger = logging.getLogger(__name__)

SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
HEADER = struct.Struct(">IIIII")  # command, sequence number, device, direction, endpoint
SUBMIT_BODY = struct.Struct(">IiiiI8s")  # flags, length, start frame, packets, interval, setup
UNLINK_BODY = struct.Struct(">I24x")
SHORT_NOT_OK = 1
EPIPE, EOVERFLOW, EREMOTEIO, ECONNRESET, ESHUTDOWN = -32, -75, -121, -104, -108


@dataclass
class Request:
    """One transfer that the kernel waits for."""

    number: int
    endpoint: int
    flags: int
    length: int
    data: bytes = b""
    setup: bytes = b""
    unlinked: threading.Event = field(default_factory=threading.Event)


class UsbIpServer:
    """One camera at one end of a socket; returns from `serve` when either side has gone."""

    def __init__(self, device: VisionDevice, connection: socket.socket) -> None:
        self._device = device
        self._connection = connection
        self._sending = threading.Lock()
        self._changed = threading.Condition()
        self._pending: dict[int, deque[Request]] = {}
        self._closing = False

    def serve(self) -> None:
        """Answer until the camera is unplugged or the kernel lets go."""
        endpoints = (0, 0x80, descriptors.CONTROL_OUT, descriptors.CONTROL_IN, descriptors.EVENT_IN)
        for endpoint in (*endpoints, descriptors.STREAM_IN):
            self._pending[endpoint] = deque()
            threading.Thread(target=self._work, args=(endpoint,), daemon=True).start()
        threading.Thread(target=self._watch_plug, daemon=True).start()
        try:
            while True:
                self._receive()
        except (ConnectionError, OSError, EOFError):
            self._closing = True

    def _watch_plug(self) -> None:
        while not self._device.unplugged and not self._closing:
            time.sleep(0.002)
        self._closing = True
        self._connection.shutdown(socket.SHUT_RDWR)

    def _exactly(self, count: int) -> bytes:
        data = self._connection.recv(count, socket.MSG_WAITALL)
        if len(data) < count:
            raise EOFError
        return data

    def _receive(self) -> None:
        command, number, _, direction, endpoint = HEADER.unpack(self._exactly(HEADER.size))
        body = self._exactly(28)
        if command == UNLINK:
            self._unlink(number, UNLINK_BODY.unpack(body)[0])
            return
        flags, length, _, _, _, setup = SUBMIT_BODY.unpack(body)
        address = endpoint | 0x80 if direction else endpoint
        data = self._exactly(length) if not direction and length else b""
        request = Request(number, address, flags, length, data, setup)
        with self._changed:
            self._pending[address].append(request)
            self._changed.notify_all()

    def _unlink(self, number: int, wanted: int) -> None:
        status = 0
        with self._changed:
            for queue in self._pending.values():
                for request in queue:
                    if request.number == wanted:
                        request.unlinked.set()
                        queue.remove(request)
                        status = ECONNRESET
                        break
            with self._sending:
                self._connection.sendall(
                    HEADER.pack(UNLINKED, number, 0, 0, 0) + struct.pack(">i24x", status)
                )

    def _work(self, endpoint: int) -> None:
        queue = self._pending[endpoint]
        while not self._closing:
            with self._changed:
                while not queue and not self._closing:
                    self._changed.wait(0.5)
                if self._closing:
                    return
                request = queue[0]
            try:
                status, answer, count = self._perform(request)
            except TimeoutError:
                continue  # nothing to give yet; the kernel may have unlinked it meanwhile
            except UnpluggedError:
                return
            with self._changed:
                if request not in queue:
                    if endpoint == descriptors.STREAM_IN and answer:
                        self._device.give_back(answer, len(answer) < request.length)
                    continue
                queue.remove(request)
                # Within the lock: the answer must be on its way before an unlinking is told "too late".
                self._answer(request, status, answer, count)

    def _answer(self, request: Request, status: int, answer: bytes, count: int) -> None:
        head = HEADER.pack(SUBMITTED, request.number, 0, 0, 0) + struct.pack(
            ">iiiii8x", status, count, 0, 0, 0
        )
        try:
            with self._sending:
                self._connection.sendall(head)
                if answer:
                    self._connection.sendall(answer)
        except OSError:
            self._closing = True

    def _perform(self, request: Request) -> tuple[int, bytes, int]:
        """(status, data for the host, bytes moved)."""
        device = self._device
        endpoint = request.endpoint
        try:
            if endpoint & 0x7F == 0:
                return self._control(request)
            if endpoint == descriptors.CONTROL_OUT:
                device.control_out(request.data)
                return 0, b"", len(request.data)
            if endpoint == descriptors.STREAM_IN:
                buffer = bytearray(request.length)
                count = device.stream_in(memoryview(buffer), 0.02)
                answer = bytes(buffer[:count])
            elif endpoint == descriptors.CONTROL_IN:
                answer = device.control_in(request.length, 0.02)
            else:
                answer = device.event_in(0.02)
        except StalledError:
            return EPIPE, b"", 0
        except OverrunError:
            return EOVERFLOW, b"", 0
        is_short = len(answer) < request.length and request.flags & SHORT_NOT_OK
        return (EREMOTEIO if is_short else 0), answer, len(answer)

    def _control(self, request: Request) -> tuple[int, bytes, int]:
        kind, what, value, index, length = struct.unpack("<BBHHH", request.setup)
        device = self._device
        if (kind, what) == (0x80, 6):
            answer = self._descriptor(value >> 8, value & 0xFF)
            return (EPIPE, b"", 0) if answer is None else (0, answer[:length], min(len(answer), length))
        if what == 0 and kind & 0x80:  # status
            return 0, b"\0\0"[:length], min(2, length)
        if (kind, what) == (0x80, 8):
            return 0, bytes([device.configuration]), 1
        if (kind, what) == (0x00, 9):
            device.configuration = value
        elif (kind, what, value) == (0x02, 1, 0):
            device.clear_halt(index)
        elif (kind, what, value) == (0x02, 3, 0):
            device.halt(index)
        return 0, b"", len(request.data)

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        if kind == 1:
            return descriptors.device_descriptor()
        if kind == 2:
            return descriptors.configuration_descriptor()
        if kind == 3 and index in (0, *descriptors.STRINGS):
            return descriptors.string_descriptor(index, self._device.serial)
        return descriptors.bos_descriptor() if kind == 15 else None
