"""Light and dark: the page's colours, and figures whose inks follow them."""

from collections.abc import Mapping
from typing import Final

from rig.presentation import palette
from rig.report.drawing import DATA, INK

LIGHT: Final[Mapping[str, str]] = {
    "paper": "#ffffff", "ink": INK, "soft": "#566070", "line": "#d9dee5", "tint": "#f4f6f9",
    "accent": palette.BLUE, "warn": "#fdf3ec", "good": "#006b4e", "bad": "#a83f00", "card": "#ffffff",
}  # fmt: skip
DARK: Final[Mapping[str, str]] = {
    "paper": "#12161c", "ink": "#e3e8ee", "soft": "#aab5c2", "line": "#38424e", "tint": "#1c232c",
    "accent": palette.SKY_BLUE, "warn": "#34241a", "good": "#3fcf9f", "bad": "#ff9a5c", "card": "#f4f6f9",
}  # fmt: skip
_IN_THE_DARK: Final = {INK: DARK["ink"], "#ffffff": DARK["paper"], "#000000": DARK["ink"], DATA: "#7cc4f0"}
"""Inks of figures that a dark ground swallows; the others of the palette read on both."""


def variables(theme: Mapping[str, str]) -> str:
    """The colours as custom properties of CSS."""
    return " ".join(f"--{name}: {colour};" for name, colour in theme.items())


def following(figure: bytes) -> bytes:
    """An SVG of lines whose inks are those of the page's theme, wherever it is shown as an image."""
    rules = [f"svg {{ fill: {DARK['ink']}; }}"]
    for light, dark in _IN_THE_DARK.items():
        for part in ("fill", "stroke"):
            rules.append(f'[style*="{part}: {light.lower()}"] {{ {part}: {dark} !important; }}')
    style = f"<style>@media (prefers-color-scheme: dark) {{ {' '.join(rules)} }}</style>"
    head, tag, rest = figure.partition(b"<defs>")
    return head + style.encode() + tag + rest
