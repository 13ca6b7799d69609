"""What is shown on the terminal while the camera is aligned."""

from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.style import Style
from rich.text import Text

from rig.align.annotated_picture import annotated_picture
from rig.align.look import AlignmentFrame

HELP = "e E exposure   g G gain   z zoom   s save a picture   q end"
_BELOW_ROWS = 10
_BARS = " ▁▂▃▄▅▆▇█"


class AligningScreen:
    """Picture, histogram and figures, drawn in place; one line a look where there is no terminal."""

    def __init__(self, console: Console, keys_help: str) -> None:
        self._console = console
        self._help = keys_help
        self._live = Live(console=console, auto_refresh=False, screen=False) if console.is_terminal else None

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, look: AlignmentFrame, zoom: float, note: str) -> None:
        """Draw a look."""
        if self._live is None:
            self._console.print(
                "  ".join(filter(None, [*look.lines(), look.beam_line, note])),
                soft_wrap=True,
                highlight=False,
            )
            return
        size = self._console.size
        picture = annotated_picture(look, size.width, 2 * max(size.height - _BELOW_ROWS, 4), zoom)
        shown = [f"zoom {zoom:g}  {histogram_line(look)}", *look.lines(), look.beam_line, note, self._help]
        text = Text("\n".join(shown), no_wrap=True, overflow="ellipsis")
        self._live.update(Group(half_blocks(picture), text), refresh=True)


def half_blocks(picture: NDArray[np.uint8]) -> Text:
    """A picture (ny, nx, 3) as characters, each of them two pixels one above the other."""
    if picture.shape[0] % 2:
        picture = np.concatenate([picture, np.zeros_like(picture[:1])])
    text = Text(no_wrap=True)
    for upper, lower in zip(picture[0::2], picture[1::2], strict=True):
        for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
            text.append("▀", Style(color=_colour(above), bgcolor=_colour(below)))
        text.append("\n")
    return text


def histogram_line(look: AlignmentFrame, bars: int = 32) -> str:
    """Counts of pixels from 0 to full scale; a bar's height is logarithmic in the count."""
    counts = np.histogram(look.image, bars, (0, look.full_scale_dn + 1))[0]
    height = np.log1p(counts) / np.log1p(counts.max())
    return f"0 {''.join(_BARS[round(8 * one)] for one in height.tolist())} {look.full_scale_dn} DN"


def _colour(rgb: list[int]) -> str:
    return f"#{rgb[0]:02x}{rgb[1]:02x}{rgb[2]:02x}"
