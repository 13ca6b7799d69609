"""The board's program: build the board, run the protocol, leave every output safe.

MicroPython starts this file at power-up. A jumper on the maintenance pin (see `board.py`)
leaves the board to the prompt, so that it can be flashed again.
"""

from board import Board  # type: ignore[import-not-found]
from core import Firmware  # type: ignore[import-not-found]


def run() -> None:
    """Serve for ever; an error that escapes leaves the outputs safe and restarts the board."""
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
