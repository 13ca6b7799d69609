"""Main program of the board: runs the protocol; when it ends, every output is switched off.

MicroPython starts this file at power-up. With a jumper on the maintenance pin (see `board.py`) it ends
immediately, so that the board can be flashed again from MicroPython's prompt.
"""

from board import Board  # type: ignore[import-not-found]
from core import Firmware  # type: ignore[import-not-found]


def run() -> None:
    """Run without end; after an error, switch the outputs off and restart the board."""
    board = Board()
    if board.maintenance():
        return
    try:
        firmware = Firmware(board)
        while True:
            firmware.step()
            board.idle()
    finally:
        board.all_off()
        board.restart()


run()
