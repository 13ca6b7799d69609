"""The controller's board, for the laser that is switched by its relay."""

from tests.rig.control.conftest import board, make_board, micropython

__all__ = ["board", "make_board", "micropython"]
