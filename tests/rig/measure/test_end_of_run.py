"""Who ended a run is known by who asked first, whatever words the others use."""

from typing import cast

from processing.errors import DataError
from rig.devices import FrameStream
from rig.interruption import BY_USER
from rig.measure.end_of_run import StopRequest


class Stream:
    """A camera's stream that takes note of the end."""

    stopped = 0

    def request_stop(self) -> None:
        self.stopped += 1


def test_only_the_first_who_asks_ends_the_run() -> None:
    stream = Stream()
    stop = StopRequest(cast(FrameStream, stream))
    assert stop.because("final amplitude reached")
    # Ctrl-C just after the end, and in the same words
    assert not stop.because(BY_USER)
    assert not stop.because("final amplitude reached")
    stop.failed(DataError("the record cannot be read"))
    assert (stop.reason, stream.stopped) == ("final amplitude reached", 1)
