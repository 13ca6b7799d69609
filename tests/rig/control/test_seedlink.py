"""A station by SeedLink: a server by the protocol's reference, with records that ObsPy has written."""

import io
import re
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from rig.control import SeedLinkStation, WitnessSettings
from tests.rig.control.test_witness import until

STREAMS = ("XX.RIG..BHN", "XX.RIG..BHE")
BEGIN_S, RATE_HZ = 1_790_000_000.003, 20.0

obspy = pytest.importorskip("obspy", reason="no ObsPy: it unpacks miniSEED")


def records(stream: str, values: np.ndarray, begin_s: float) -> list[bytes]:
    """Records of 512 bytes."""
    network, station, location, channel = stream.split(".")
    header = {"network": network, "station": station, "location": location, "channel": channel}
    header |= {"sampling_rate": RATE_HZ, "starttime": obspy.UTCDateTime(begin_s)}
    file = io.BytesIO()
    obspy.Stream([obspy.Trace(values.astype(np.int32), header)]).write(file, format="MSEED", reclen=512)
    data = file.getvalue()
    return [data[at : at + 512] for at in range(0, len(data), 512)]


class Server:
    """One station; sends what `send` is given to whoever has selected streams of it."""

    def __init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self.orders: list[str] = []
        self._clients: list[socket.socket] = []
        self.streaming = 0
        self._number = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            self._clients.append(client)
            threading.Thread(target=self._negotiate, args=(client,), daemon=True).start()

    def _negotiate(self, client: socket.socket) -> None:
        with client.makefile("rb") as lines:
            for line in lines:
                order = line.decode().strip()
                self.orders.append(order)
                if order == "HELLO":
                    client.sendall(b"SeedLink v3.1 (test)\r\nno site\r\n")
                elif order == "END":
                    self.streaming += 1
                    return
                else:
                    known = re.fullmatch(r"STATION RIG XX|SELECT BH[NE]\.D|DATA", order)
                    client.sendall(b"OK\r\n" if known else b"ERROR\r\n")

    def send(self, *packets: bytes) -> None:
        for packet in packets:
            self._number += 1
            whole = f"SL{self._number:06X}".encode() + packet
            # in two pieces, as a network may
            self._clients[-1].sendall(whole[:100])
            time.sleep(0)
            self._clients[-1].sendall(whole[100:])

    def drop(self) -> None:
        self._clients[-1].shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listening.close()
        for client in self._clients:
            client.close()


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.close()


def station_at(port: int, columns: tuple[str, ...] = STREAMS) -> SeedLinkStation:
    return SeedLinkStation(WitnessSettings(kind="seedlink", server=f"127.0.0.1:{port}", columns=columns))


def test_channels_are_put_together_at_their_own_times(server: Server) -> None:
    north, east = np.arange(1000) - 500, 7 * np.arange(1000)
    with station_at(server.port) as station:
        assert station.silent
        until(lambda: server.streaming == 1)
        server.send(*records(STREAMS[0], north, BEGIN_S))
        # a packet about something else, and one that is no record
        server.send(*records("XX.RIG..BHZ", north, BEGIN_S)[:1], b"\0" * 512)
        server.send(*records(STREAMS[1], east, BEGIN_S))
        samples = []

        def all_there() -> bool:
            samples.extend(station.take_samples())
            return len(samples) == 1000

        until(all_there)
        ahead_ns = time.time_ns() - time.monotonic_ns()
        assert not station.silent
        assert station.unread_lines == 2
    assert server.orders[:5] == ["HELLO", "STATION RIG XX", "SELECT BHN.D", "SELECT BHE.D", "DATA"]
    assert [one.value for one in samples] == list(zip(north.astype(float), east.astype(float), strict=True))
    own_s = np.array([one.own_time_s for one in samples])
    # miniSEED of this version holds tenths of a millisecond
    assert own_s == pytest.approx(BEGIN_S + np.arange(1000) / RATE_HZ, abs=1e-4)
    host_s = np.array([one.host_time_ns + ahead_ns for one in samples]) * 1e-9
    assert host_s == pytest.approx(own_s, abs=0.05)


@pytest.mark.slow
def test_a_connection_that_is_closed_is_made_again(server: Server) -> None:
    with station_at(server.port) as station:
        until(lambda: server.streaming == 1)
        server.drop()
        until(lambda: server.streaming == 2)
        assert station.take_events() == (f"127.0.0.1:{server.port}: the server has closed the connection",)


def test_a_stream_that_is_not_there_is_named(server: Server) -> None:
    with station_at(server.port, ("XX.RIG.00.LHZ",)) as station:
        events: list[str] = []
        until(lambda: bool(events.extend(station.take_events()) or events))
    assert events[0].endswith("the server refuses 'SELECT 00LHZ.D'; see witness.columns")


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ({"server": ""}, "should be host:port, as geofon.gfz.de:18000"),
        ({"server": "host:1", "columns": ["BHN"]}, "should be a stream, NET.STA.LOC.CHA"),
    ],
)
def test_faults_of_the_configuration_are_named(words: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        WitnessSettings.model_validate({"kind": "seedlink", "columns": list(STREAMS), **words})
