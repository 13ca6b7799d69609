"""The colours of the desk, by name, in a dark and a light theme: the system's preference decides.

Everything on the page takes its colours from here, as ``var(--name)``. Each ink has the contrast to its
grounds that WCAG 2 asks for at level AA.
"""

from collections.abc import Mapping
from typing import Final

from rig.presentation import palette

_IN_BOTH: Final[Mapping[str, str]] = {
    "picture": "#000000",
    "picture-ink": "#ffffff",
    "lamp-go": palette.BLUISH_GREEN,
    "lamp-caution": palette.YELLOW,
    "lamp-no": palette.VERMILLION,
    "bar": "#000000",
    "bar-ink": "#ffffff",
    "bar-dim": "#bbbbbb",
    "bar-button": "#333333",
    "off": "#c00000",
    "off-ink": "#ffffff",
}
THEMES: Final[Mapping[str, Mapping[str, str]]] = {
    "dark": {
        "ground": "#0e1113",
        "card": "#181d21",
        "raised": "#242b31",
        "edge": "#75828d",
        "ink": "#e8e8e8",
        "dim": "#a9b3bc",
        "line": palette.SKY_BLUE,
        "second": palette.ORANGE,
        "go": "#3fc79f",
        "warn": palette.ORANGE,
        "no": "#ff8a5c",
        "go-ground": palette.BLUISH_GREEN,
        "no-ground": palette.VERMILLION,
        "alarm": palette.VERMILLION,
        "told": palette.YELLOW,
        "on-ground": "#000000",
        **_IN_BOTH,
    },
    "light": {
        "ground": "#f2f4f6",
        "card": "#ffffff",
        "raised": "#e8ecf0",
        "edge": "#74808b",
        "ink": "#171c21",
        "dim": "#4f5a64",
        "line": "#005a9c",
        "second": "#8a4b00",
        "go": "#00614a",
        "warn": "#7a4d00",
        "no": "#a83200",
        "go-ground": "#00694f",
        "no-ground": "#b03a00",
        "alarm": "#b03a00",
        "told": "#004f8a",
        "on-ground": "#ffffff",
        **_IN_BOTH,
    },
}


def named_colours() -> str:
    """The themes as CSS."""
    dark, light = (
        f":root {{ color-scheme: {name}; "
        + " ".join(f"--{key}: {colour};" for key, colour in THEMES[name].items())
        + " }"
        for name in ("dark", "light")
    )
    return f"{dark}\n@media (prefers-color-scheme: light) {{ {light} }}"
