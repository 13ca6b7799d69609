"""The controller's board, for the laser that is switched by its relay, and a laser with a port of its own."""

from collections.abc import Iterator

import pytest

from tests.rig.control.conftest import board, make_board, micropython
from tests.rig.control.instruments import FakeCobolt

__all__ = ["board", "make_board", "micropython"]


@pytest.fixture
def instrument() -> Iterator[FakeCobolt]:
    """A laser with a port of its own, which no watchdog darkens."""
    instrument = FakeCobolt()
    yield instrument
    instrument.close()
