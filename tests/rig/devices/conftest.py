"""The controller's board, for the laser that is lit through its relay."""

from tests.rig.control.conftest import board, make_board, micropython

__all__ = ["board", "make_board", "micropython"]
