"""Drawings of the desk as SVG text: trajectory, decay, histogram, focus curve, pendulum with its weights."""

import html
import math
from collections.abc import Sequence

from rig.calibrate import Residuals

Points = Sequence[tuple[float, float]]
_MARGIN = 34


def table(rows: Sequence[Sequence[str]], label: str) -> str:
    """A table of text whose first column names the rest."""
    lines = [
        f"<tr><th scope='row'>{html.escape(row[0])}</th>"
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in rows
    ]
    return f"<table class='rows' aria-label='{html.escape(label)}'>{''.join(lines)}</table>"


def curve(points: Points, size: tuple[int, int], label: str, x_name: str, y_name: str) -> str:
    """A curve through points, with the ends of its axes as text; y from 0 on if nothing is negative."""
    width, height = size
    good = [(x, y) for x, y in points if math.isfinite(x) and math.isfinite(y)]
    if len(good) < 2:
        return _svg(size, f"<text x='12' y='{height / 2:.0f}'>no {html.escape(y_name)} yet</text>", label)
    low_x, high_x = good[0][0], max(good[-1][0], good[0][0] + 1e-9)
    low_y, high_y = min(0.0, min(y for _, y in good)), max(y for _, y in good) or 1.0

    def at(x: float, y: float) -> str:
        across = _MARGIN + (x - low_x) / (high_x - low_x) * (width - _MARGIN - 8)
        down = height - 20 - (y - low_y) / (high_y - low_y) * (height - 34)
        return f"{across:.1f},{down:.1f}"

    drawn = " ".join(at(x, y) for x, y in good)
    parts = [
        f"<polyline points='{drawn}' fill='none' stroke='var(--line)' stroke-width='2'/>",
        f"<text x='2' y='12'>{high_y:.4g} {html.escape(y_name)}</text>",
        f"<text x='2' y='{height - 20}'>{low_y:.4g}</text>",
        f"<text x='{width - 6}' y='{height - 4}' text-anchor='end'>{high_x:.4g} {html.escape(x_name)}</text>",
    ]
    return _svg(size, "".join(parts), label)


def residuals(left: Residuals, size: tuple[int, int]) -> str:
    """Points with their standard uncertainties about the line of zero."""
    width, height = size
    low_x, high_x = min(left.x), max(max(left.x), min(left.x) + 1e-9)
    most = max((abs(y) + u for y, u in zip(left.y, left.u, strict=True)), default=0.0) or 1.0
    middle = (height - 16) / 2

    def down(y: float) -> float:
        return middle - y / most * (middle - 14)

    parts = [f"<line x1='{_MARGIN}' y1='{middle}' x2='{width}' y2='{middle}' stroke='var(--dim)'/>"]
    for x, y, u in zip(left.x, left.y, left.u, strict=True):
        across = _MARGIN + 8 + (x - low_x) / (high_x - low_x) * (width - _MARGIN - 20)
        parts.append(
            f"<line x1='{across:.1f}' y1='{down(y + u):.1f}' x2='{across:.1f}' y2='{down(y - u):.1f}' "
            "stroke='var(--line)' stroke-width='1.5'/>"
            f"<circle cx='{across:.1f}' cy='{down(y):.1f}' r='3' fill='var(--line)'/>"
        )
    x_name = html.escape(left.x_name)
    parts += [
        f"<text x='2' y='12'>±{most:.3g}: {html.escape(left.y_name)}</text>",
        f"<text x='{_MARGIN}' y='{height - 2}'>{low_x:.4g}</text>",
        f"<text x='{width - 6}' y='{height - 2}' text-anchor='end'>{high_x:.4g}: {x_name}</text>",
    ]
    return _svg(size, "".join(parts), f"{left.title}, {left.y_name} against {left.x_name}")


def trajectory(
    x: Sequence[float | None],
    y: Sequence[float | None],
    unit: str,
    size: tuple[int, int],
    stretch: float = 1.0,
) -> str:
    """The trajectory of the spot; `stretch` makes X so much larger than Y. Gaps are left open."""
    width, height = size
    known = [(a, b) for a, b in zip(x, y, strict=True) if a is not None and b is not None]
    label = f"trajectory of the last seconds in {unit}, X times {stretch:g}"
    if not known:
        return _svg(size, f"<text x='12' y='{height / 2:.0f}'>no trajectory yet</text>", label)
    largest = max(max(abs(a) * stretch, abs(b)) for a, b in known) or 1.0
    scale = (min(width, height) / 2 - 18) / largest
    parts = [
        f"<line x1='{width / 2}' y1='0' x2='{width / 2}' y2='{height}' stroke='var(--dim)'/>",
        f"<line x1='0' y1='{height / 2}' x2='{width}' y2='{height / 2}' stroke='var(--dim)'/>",
    ]
    piece: list[str] = []
    for a, b in [*zip(x, y, strict=True), (None, None)]:
        if a is not None and b is not None:
            piece.append(f"{width / 2 + a * stretch * scale:.1f},{height / 2 + b * scale:.1f}")
        elif piece:
            way = " ".join(piece)
            parts.append(f"<polyline points='{way}' fill='none' stroke='var(--line)' stroke-width='1.5'/>")
            piece = []
    a, b = known[-1]
    parts.append(
        f"<circle cx='{width / 2 + a * stretch * scale:.1f}' cy='{height / 2 + b * scale:.1f}' r='4' "
        "fill='var(--warn)'/>"
    )
    parts.append(
        f"<text x='4' y='14'>±{largest:.3g} {unit}{f', X × {stretch:g}' if stretch != 1 else ''}</text>"
    )
    return _svg(size, "".join(parts), label)


def bars(counts: Sequence[int], size: tuple[int, int], label: str, last: str) -> str:
    """A histogram; heights are logarithmic in the counts, the last bar is that of full scale."""
    width, height = size
    most = math.log1p(max(counts, default=0)) or 1.0
    step = width / max(len(counts), 1)
    parts = []
    for place, count in enumerate(counts):
        tall = (height - 16) * math.log1p(count) / most
        colour = "var(--no)" if place == len(counts) - 1 and count else "var(--line)"
        parts.append(
            f"<rect x='{place * step:.1f}' y='{height - 14 - tall:.1f}' width='{step - 1:.1f}' "
            f"height='{tall:.1f}' fill='{colour}'/>"
        )
    parts.append(f"<text x='0' y='{height - 2}'>0</text>")
    parts.append(f"<text x='{width}' y='{height - 2}' text-anchor='end'>{html.escape(last)}</text>")
    return _svg(size, "".join(parts), label)


def _svg(size: tuple[int, int], inside: str, label: str) -> str:
    width, height = size
    return (
        f"<svg viewBox='0 0 {width} {height}' width='100%' role='img' aria-label='{html.escape(label)}' "
        f"style='max-height:{height}px'>{inside}</svg>"
    )
