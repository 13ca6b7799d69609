"""Tables for LaTeX: numbers and units for siunitx, symbols in mathematics."""

import re
from collections.abc import Sequence
from typing import Final

from processing.errors import ConfigurationError
from processing.units import factors, split_prefix
from rig.terminal.printing import Table

_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_SUPERSCRIPTS: Final = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹ᵖ", "-0123456789p")
_SUBSCRIPTS: Final = str.maketrans("₀₁₂₃₄₅₆₇₈₉ₜ", "0123456789t")
_GREEK: Final = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "varepsilon", "ζ": "zeta", "η": "eta",
    "θ": "theta", "κ": "kappa", "λ": "lambda", "μ": "mu", "ν": "nu", "ξ": "xi", "π": "pi", "ρ": "rho",
    "σ": "sigma", "τ": "tau", "φ": "varphi", "χ": "chi", "ψ": "psi", "ω": "omega", "Γ": "Gamma",
    "Δ": "Delta", "Σ": "Sigma", "Φ": "Phi", "Ω": "Omega",
}  # fmt: skip
_CHARACTERS: Final = {
    "−": "$-$", "×": r"$\times$", "·": r"$\cdot$", "±": r"$\pm$", "…": r"\dots{}", "–": "--", "√": r"$\surd$",
    "≤": r"$\le$", "≥": r"$\ge$", "≈": r"$\approx$", "<": "$<$", ">": "$>$", "µ": r"\textmu{}",
    "Λ": r"$\Lambda$",
    "″": r"$''$", "′": r"$'$", "°": r"$^\circ$", "→": r"$\to$", "∞": r"$\infty$",
    "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}",
}  # fmt: skip
_UNITS: Final = {
    "m": "metre", "g": "gram", "s": "second", "A": "ampere", "V": "volt", "Hz": "hertz", "N": "newton",
    "Pa": "pascal", "J": "joule", "W": "watt", "rad": "radian", "%": "percent", "mas": r"milli\arcsecond",
    "min": "minute", "h": "hour", "d": "day", "deg": "degree", "arcmin": "arcminute", "arcsec": "arcsecond",
    "°C": "degreeCelsius", "K": "kelvin", "dB": "decibel",
}  # fmt: skip
"""siunitx's names of the units of the project's table."""
_PREFIXES: Final = {
    "G": "giga", "M": "mega", "k": "kilo", "h": "hecto", "c": "centi", "m": "milli", "u": "micro",
    "n": "nano", "p": "pico", "f": "femto",
}  # fmt: skip
_WITH_U = re.compile(rf"\(?({_NUMBER}) ± ({_NUMBER})\)?(?: × 10([⁻⁰¹²³⁴-⁹]+))?")
_PLAIN = re.compile(rf"({_NUMBER})(?: × 10([⁻⁰¹²³⁴-⁹]+))?")


def latex_table(content: Table, label: str = "") -> str:
    """A table as a float for booktabs and siunitx, with the shown numbers and symbols.

    Rows are those of the report: rounded, with standard uncertainties. `label` distinguishes tables of
    several runs; empty: the table's name.
    """
    head, rows = content.head, content.shown
    unit_column = next((place for place, cell in enumerate(head) if cell == "unit"), -1)
    lines = [
        "% needs \\usepackage{booktabs,siunitx} and \\sisetup{separate-uncertainty=true}",
        r"\begin{table}",
        rf"\caption{{{_text(content.title)}}}",
        rf"\label{{tab:{label or content.name}}}",
        rf"\begin{{tabular}}{{l{'r' * (max(1, len(head)) - 1)}}}",
        r"\toprule",
    ]
    if any(head):
        lines += [" & ".join(_heading(cell) for cell in head) + r" \\", r"\midrule"]
    for row in rows:
        cells = [_unit(cell) if place == unit_column else _cell(cell) for place, cell in enumerate(row)]
        lines.append(" & ".join(cells) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}"]
    if content.note:
        lines.append(rf"\par\footnotesize {_text(content.note)}")
    return "\n".join([*lines, r"\end{table}", ""])


def latex_rows(head: Sequence[str], cells: Sequence[str], name: str) -> str:
    """Two rows of a table in LaTeX: labels, and cells after the `name`."""
    return "\n".join(
        " & ".join(["", *map(_heading, head)] if row is head else [_text(name), *map(_cell, row)]).strip()
        + r" \\"
        for row in (head, cells)
    )


def _heading(label: str) -> str:
    """A label such as `γ / MPa` in LaTeX."""
    symbol, slash, unit = label.partition(" / ")
    if not slash:
        return _text(label)
    unit = unit[1:-1] if unit.startswith("(") and unit.endswith(")") else unit
    return f"{_text(symbol)} / {_unit(unit)}"


def _cell(text: str) -> str:
    """A cell in LaTeX: a number with its uncertainty, a number, or words with numbers."""
    spelled = text.replace("−", "-")
    if found := _WITH_U.fullmatch(spelled):
        value, u, power = found.groups()
        return rf"\num{{{value} +- {u}{_power(power)}}}"
    if found := _PLAIN.fullmatch(spelled):
        return rf"\num{{{found[1]}{_power(found[2])}}}"
    return _text(text)


def _power(raised: str | None) -> str:
    return "" if raised is None else f" e{raised.translate(_SUPERSCRIPTS)}"


def _unit(text: str) -> str:
    """A unit by siunitx's names; one that it does not name as text."""
    try:
        return rf"\unit{{{_siunitx(text)}}}"
    except (ConfigurationError, KeyError):
        # a power that is a parameter (`rad⁻ᵖ`) is for siunitx, too
        named = re.fullmatch(r"([A-Za-z]+)([⁻⁰¹²³⁴-⁹ᵖ]+)", text)
        return rf"\unit{{{named[1]}^{{{named[2].translate(_SUPERSCRIPTS)}}}}}" if named else _text(text)


def _siunitx(unit: str) -> str:
    """A unit by siunitx's names.

    Raises ConfigurationError if it is no unit, KeyError for what siunitx does not name: one, ppm, counts.
    """
    words = []
    for symbol, power in factors(unit):
        prefix, rest = split_prefix(symbol.replace("μ", "u").replace("µ", "u"))
        # kilogram is the only unit with its prefix in its name
        word = "".join(f"\\{name}" for name in (_PREFIXES.get(prefix), _UNITS[rest]) if name)
        word = word.replace(r"\kilo\gram", r"\kilogram")
        raised = power if power.denominator == 1 else float(power)
        words.append(word if power == 1 else rf"{word}\tothe{{{raised}}}")
    return "".join(words)


def _text(text: str) -> str:
    """Words in LaTeX, with symbols and powers in mathematics."""
    found = re.sub(
        r"(×) 10([⁻⁰¹²³⁴-⁹]+)", lambda power: f"\0\\times 10^{{{power[2].translate(_SUPERSCRIPTS)}}}\0", text
    )
    parts = []
    for place, part in enumerate(found.split("\0")):
        parts.append(f"${part}$" if place % 2 else "".join(_word(piece) for piece in _pieces(part)))
    return "".join(parts)


def _pieces(text: str) -> list[str]:
    return re.findall(r"[A-Za-zα-ωΓΔΣΦΩ]\u0304?[₀-₉ₜ]+|[A-Za-zα-ωΓΔΣΦΩ]\u0304|[⁻⁰¹²³⁴-⁹ᵖ]+|.", text)


def _word(piece: str) -> str:
    if piece[0] in "⁻⁰¹²³⁴⁵⁶⁷⁸⁹ᵖ":
        return f"$^{{{piece.translate(_SUPERSCRIPTS)}}}$"
    letter, below = piece[0], piece[1:].translate(_SUBSCRIPTS)
    symbol = f"\\{_GREEK[letter]}" if letter in _GREEK else letter
    if len(piece) > 1:
        symbol = rf"\bar{{{symbol}}}" if "\u0304" in below else symbol
        below = below.replace("\u0304", "")
        return f"${symbol}_{{{below}}}$" if below else f"${symbol}$"
    return f"${symbol}$" if letter in _GREEK else _CHARACTERS.get(piece, piece)
