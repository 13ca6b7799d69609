"""Aravis's fake GigE camera in a process that can be killed and restarted."""

import subprocess

from tests.acquisition.cameras.aravis.namespace import camera_program

SERIAL = "GV0815"


class FakeCamera:
    """One fake camera on the loopback; `lost_per_thousand` packets of its stream never leave it."""

    def __init__(self, lost_per_thousand: int = 0) -> None:
        self._options = ["-i", "127.0.0.1", "-s", SERIAL, "-r", str(lost_per_thousand)]
        self._process: subprocess.Popen[bytes] | None = None
        self.plug_in()

    def plug_in(self) -> None:
        """Start it; it answers a little later."""
        self._process = subprocess.Popen(
            [camera_program(), *self._options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    def pull_out(self) -> None:
        """Kill it: it says no more."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
