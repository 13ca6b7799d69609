"""A station of a seismic network as the witness of the ground, by SeedLink (version 3).

Packets of 512 bytes of miniSEED come seconds late and hold their own times in UTC, which the clock of this
computer relates to the frames: it should be kept by NTP. ObsPy unpacks them.
"""

import contextlib
import io
import math
import re
import select
import socket
import time
from typing import Any

from processing.errors import DeviceError
from processing.ticks import nanoseconds
from rig.control.settings import WitnessSettings
from rig.control.witness import WitnessSample, WitnessSamples

_PORT = 18000
_REOPEN_S = 5.0
_ANSWER_S = 10.0
_SILENT_S = 120.0
"""Without a byte for so long the connection is made anew; packets come every few seconds."""
_READ_S = 0.1
_HEADER, _RECORD = 8, 512
_PACKET = re.compile(rb"SL([0-9A-F]{6})")
_WAITING = 20_000
"""Samples of one channel that wait for the others."""


class SeedLinkStation(WitnessSamples):
    """Samples at which every stated channel has a value; `own_time_s` is UTC, in s since 1970."""

    def __init__(self, settings: WitnessSettings) -> None:
        self._socket: socket.socket | None = None
        self._bytes = b""
        self._heard_s = 0.0
        self._waiting: dict[int, tuple[float, dict[str, float]]] = {}
        super().__init__(settings)

    def _turn(self) -> float:
        try:
            if self._socket is None:
                self._open()
            self._read()
        except (OSError, DeviceError) as error:
            self._say_once(f"{self._settings.server}: {error}")
            self._finish()
            return _REOPEN_S
        return 0.0

    def _open(self) -> None:
        host, _, port = self._settings.server.partition(":")
        self._socket = socket.create_connection((host, int(port or _PORT)), timeout=_ANSWER_S)
        self._bytes, self._heard_s = b"", time.monotonic()
        self._waiting.clear()
        if not self._answer("HELLO", lines=2).upper().startswith(b"SEEDLINK"):
            raise DeviceError("the server there does not speak SeedLink; check witness.server")
        streams = [stream.split(".") for stream in self._settings.columns]
        for network, station in dict.fromkeys((one[0], one[1]) for one in streams):
            chosen = [f"SELECT {one[2]}{one[3]}.D" for one in streams if one[:2] == [network, station]]
            for order in (f"STATION {station} {network}", *chosen, "DATA"):
                if self._answer(order) != b"OK":
                    raise DeviceError(f"the server refuses {order!r}; see witness.columns")
        self._socket.sendall(b"END\r\n")
        self._last_error = ""

    def _answer(self, order: str, lines: int = 1) -> bytes:
        assert self._socket is not None
        self._socket.sendall(f"{order}\r\n".encode())
        while self._bytes.count(b"\n") < lines:
            self._receive()
        answer, self._bytes = self._bytes.split(b"\n", lines)[0], self._bytes.split(b"\n", lines)[lines]
        return answer.strip()

    def _receive(self) -> None:
        assert self._socket is not None
        data = self._socket.recv(1 << 16)
        if not data:
            raise DeviceError("the server has closed the connection")
        self._bytes += data
        self._heard_s = time.monotonic()

    def _read(self) -> None:
        assert self._socket is not None
        if select.select([self._socket], [], [], _READ_S)[0]:
            self._receive()
        elif time.monotonic() - self._heard_s > _SILENT_S:
            raise DeviceError(f"nothing for {_SILENT_S:g} s")
        while len(self._bytes) >= _HEADER + _RECORD:
            header, record = self._bytes[:_HEADER], self._bytes[_HEADER : _HEADER + _RECORD]
            if header.startswith(b"SLINFO"):
                pass
            elif _PACKET.fullmatch(header) is None:
                raise DeviceError(f"{header!r} is not a SeedLink packet")
            else:
                self._take(record)
            self._bytes = self._bytes[_HEADER + _RECORD :]

    def _take(self, record: bytes) -> None:
        try:
            stream, start_s, rate_hz, values = _unpacked(record)
        except Exception as error:
            # whatever a damaged record makes of ObsPy
            self.unread_lines += 1
            self.last_line = f"a record that ObsPy does not read: {error}"[:80]
            return
        if stream not in self._settings.columns:
            self.unread_lines += 1
            self.last_line = f"a record of {stream}"
            return
        for number, value in enumerate(values):
            # channels of one station are sampled together, on times that differ by roundings
            utc_s = start_s + number / rate_hz
            tick = round(utc_s * rate_hz)
            utc_s, found = self._waiting.setdefault(tick, (utc_s, {}))
            found[stream] = value
            if len(found) == len(self._settings.columns):
                del self._waiting[tick]
                self._keep(self._sample(found, utc_s))
        while len(self._waiting) > _WAITING:
            del self._waiting[min(self._waiting)]

    def _sample(self, found: dict[str, float], utc_s: float) -> WitnessSample:
        ahead_ns = time.time_ns() - time.monotonic_ns()
        values = tuple(found[name] for name in self._settings.columns)
        return WitnessSample(nanoseconds(utc_s) - ahead_ns, utc_s, values)

    def _finish(self) -> None:
        opened, self._socket = self._socket, None
        if opened is not None:
            with contextlib.suppress(OSError):
                opened.close()


def _unpacked(record: bytes) -> tuple[str, float, float, list[float]]:
    """Stream (NET.STA.LOC.CHA), UTC of the first sample in s, rate, and samples of a record."""
    # here, because it takes a second
    from obspy import read

    (trace,) = read(io.BytesIO(record), format="MSEED")
    values: Any = trace.data
    rate_hz = float(trace.stats.sampling_rate)
    if not math.isfinite(rate_hz) or rate_hz <= 0:
        raise DeviceError(f"a rate of {rate_hz} per s")
    return trace.id, float(trace.stats.starttime.timestamp), rate_hz, [float(one) for one in values]
