"""The colours of the desk, by name, in its three themes: dark, day, and red light only for the night.

Everything on the page takes its colours from here, as ``var(--name)``. `PAIRS` are the inks with the grounds
they are used on; each has the contrast that WCAG 2 asks for at level AA.
"""

from collections.abc import Mapping
from typing import Final

from rig.presentation import palette

DARK: Final = "dark"
"""The theme of a page that nobody has chosen one for."""

THEMES: Final[Mapping[str, Mapping[str, str]]] = {
    DARK: {
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
        "bar": "#000000",
        "bar-ink": "#ffffff",
        "bar-dim": "#bbbbbb",
        "bar-button": "#333333",
        "off": "#c00000",
        "off-ink": "#ffffff",
    },
    "day": {
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
        "bar": "#000000",
        "bar-ink": "#ffffff",
        "bar-dim": "#bbbbbb",
        "bar-button": "#333333",
        "off": "#c00000",
        "off-ink": "#ffffff",
    },
    # eyes that are used to the dark see red light least
    "night": {
        "ground": "#000000",
        "card": "#120000",
        "raised": "#1a0000",
        "edge": "#cc0000",
        "ink": "#ff0000",
        "dim": "#f40000",
        "line": "#ff0000",
        "second": "#f40000",
        "go": "#ff0000",
        "warn": "#ff0000",
        "no": "#ff0000",
        "go-ground": "#ff0000",
        "no-ground": "#ff0000",
        "alarm": "#ff0000",
        "told": "#ff0000",
        "on-ground": "#000000",
        "bar": "#000000",
        "bar-ink": "#ff0000",
        "bar-dim": "#f40000",
        "bar-button": "#000000",
        "off": "#ff0000",
        "off-ink": "#000000",
    },
}

_TEXTS = ("ink", "dim", "line", "go", "warn", "no")
PAIRS: Final = (
    *((ink, ground) for ink in _TEXTS for ground in ("ground", "card", "raised")),
    *(("on-ground", ground) for ground in ("go-ground", "no-ground", "alarm", "told")),
    ("bar-ink", "bar"),
    ("bar-dim", "bar"),
    ("bar-ink", "bar-button"),
    ("off-ink", "off"),
)
"""Ink and ground of every text; 4.5 is asked."""
DRAWN: Final = (
    *((ink, ground) for ink in ("edge", "line", "second") for ground in ("ground", "card")),
    ("edge", "raised"),
)
"""Curves, and edges of what can be filled or pressed; 3 is asked."""


def contrast(one: str, other: str) -> float:
    """Contrast of two ``#rrggbb`` colours as WCAG 2 defines it, 1 to 21."""
    brighter, darker = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (brighter + 0.05) / (darker + 0.05)


def _luminance(colour: str) -> float:
    red, green, blue = (
        part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4
        for part in (one / 255 for one in palette.rgba(colour)[:3])
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def named_colours() -> str:
    """The themes as CSS: a class of the root for each but the first, which holds without one."""
    blocks = []
    for theme, colours in THEMES.items():
        root = ":root" if theme == DARK else f":root.{theme}"
        scheme = "light" if theme == "day" else "dark"
        named = " ".join(f"--{name}: {colour};" for name, colour in colours.items())
        blocks.append(f"{root} {{ color-scheme: {scheme}; {named} }}")
    return "\n".join(blocks)


_RED = "1 .2 .1 0 0  0 0 0 0 0  0 0 0 0 0  0 0 0 1 0"
RED_LIGHT: Final = f"""
<svg width="0" height="0" style="position: absolute" aria-hidden="true" focusable="false"><filter id="night"
  color-interpolation-filters="sRGB"><feColorMatrix values="{_RED}"/></filter></svg>
"""
"""Turns what is not red already into red, the pictures of the camera included; red itself stays."""


def themed_report(page: str, theme: str) -> str:
    """The page of a report in a theme of the desk; as it is in one that there is not."""
    if theme not in THEMES:
        return page
    own = THEMES[theme]
    style = (
        f":root {{ --ink: {own['ink']}; --soft: {own['dim']}; --line: {own['edge']}; "
        f"--tint: {own['raised']}; --accent: {own['line']}; }} "
        f"html {{ background: {own['ground']}; color: {own['ink']}; }} "
        f".warn {{ background: {own['raised']}; border-color: {own['no']}; }}"
    )
    if theme != "day":
        # the figures are drawn dark on white
        style += " html { color-scheme: dark; } figure img { filter: invert(1) hue-rotate(180deg); }"
    if theme == "night":
        style += " html { filter: url(#night); }"
        page = page.replace("<body>", f"<body>{RED_LIGHT}", 1)
    return page.replace("</head>", f"<style>@media screen {{ {style} }}</style></head>", 1)
