"""The pages of a TIFF file, counted by its directories, so that one that was cut off is noticed."""

from pathlib import Path
from typing import BinaryIO, Final, Literal

_Order = Literal["little", "big"]
_ORDERS: Final[dict[bytes, _Order]] = {b"II": "little", b"MM": "big"}
_MOST_PAGES = 10_000_000


def is_cut_off(path: Path) -> bool:
    """Whether a directory, to which the file or a page refers, lies beyond the end of the file.

    False as well for a file that is no TIFF, which is for others to report.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(16)
        order = _ORDERS.get(head[:2])
        if order is None or len(head) < 8:
            return False
        big = int.from_bytes(head[2:4], order) == 43
        offset = int.from_bytes(head[8:16] if big else head[4:8], order)
        for _ in range(_MOST_PAGES):
            if not offset:
                return False
            following = _following(file, offset, size, order, big)
            if following is None:
                return True
            offset = following
    return False


def _following(file: BinaryIO, offset: int, size: int, order: _Order, big: bool) -> int | None:
    """Place of the directory after the one at `offset`, 0 after the last; None if the file ends before."""
    count_bytes, entry_bytes, place_bytes = (8, 20, 8) if big else (2, 12, 4)
    if offset + count_bytes > size:
        return None
    file.seek(offset)
    count = int.from_bytes(file.read(count_bytes), order)
    end = offset + count_bytes + count * entry_bytes
    if end + place_bytes > size:
        return None
    file.seek(end)
    return int.from_bytes(file.read(place_bytes), order)
