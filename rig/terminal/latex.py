"""Tables for LaTeX: numbers and units for siunitx, symbols in mathematics."""

import re
from collections.abc import Sequence
from typing import Final

from processing.errors import ConfigurationError
from processing.units import factors, split_prefix
from rig.terminal.printing import Table

_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_SUPERSCRIPT = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"
_SUPERSCRIPT_VALUES: Final = str.maketrans(f"{_SUPERSCRIPT}ᵖ", "-0123456789p")
_SUBSCRIPT_VALUES: Final = str.maketrans("₀₁₂₃₄₅₆₇₈₉ₜ", "0123456789t")
_GREEK: Final = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "varepsilon", "ζ": "zeta", "η": "eta",
    "θ": "theta", "κ": "kappa", "λ": "lambda", "μ": "mu", "ν": "nu", "ξ": "xi", "π": "pi", "ρ": "rho",
    "σ": "sigma", "τ": "tau", "φ": "varphi", "χ": "chi", "ψ": "psi", "ω": "omega", "Γ": "Gamma",
    "Δ": "Delta", "Λ": "Lambda", "Σ": "Sigma", "Φ": "Phi", "Ω": "Omega",
}  # fmt: skip
_CHARACTERS: Final = {
    "−": "$-$", "×": r"$\times$", "·": r"$\cdot$", "±": r"$\pm$", "…": r"\dots{}", "–": "--", "√": r"$\surd$",
    "≤": r"$\le$", "≥": r"$\ge$", "≈": r"$\approx$", "<": "$<$", ">": "$>$", "µ": r"\textmu{}",
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
_POWER_OF_TEN = rf"× 10([{_SUPERSCRIPT}]+)"
_NUMBER_WITH_U = re.compile(rf"\(?({_NUMBER}) ± ({_NUMBER})\)?(?: {_POWER_OF_TEN})?")
_PLAIN_NUMBER = re.compile(rf"({_NUMBER})(?: {_POWER_OF_TEN})?")
_LETTER = r"[A-Za-zα-ωΓΔΣΦΩ]"
# a letter may have a bar (U+0304) and a subscript
_PIECE = re.compile(rf"{_LETTER}\u0304?[₀-₉ₜ]+|{_LETTER}\u0304|[{_SUPERSCRIPT}ᵖ]+|.")


def latex_table(content: Table, label: str = "") -> str:
    """A LaTeX `table` environment for booktabs and siunitx, with the rounded numbers of the report.

    `label` distinguishes tables of several runs; if it is empty, the table's name is the label.
    """
    head, rows = content.head, content.shown
    unit_column = next((column for column, heading in enumerate(head) if heading == "unit"), -1)
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
        cells = [_unit(cell) if column == unit_column else _cell(cell) for column, cell in enumerate(row)]
        lines.append(" & ".join(cells) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}"]
    if content.note:
        lines.append(rf"\par\footnotesize {_text(content.note)}")
    return "\n".join([*lines, r"\end{table}", ""])


def latex_rows(head: Sequence[str], cells: Sequence[str], name: str) -> str:
    """Two rows of a table in LaTeX: the labels, and below them the cells after the `name`."""
    rows = (["", *map(_heading, head)], [_text(name), *map(_cell, cells)])
    return "\n".join(" & ".join(row).strip() + r" \\" for row in rows)


def _heading(label: str) -> str:
    """A label such as `γ / MPa` in LaTeX."""
    symbol, slash, unit = label.partition(" / ")
    if not slash:
        return _text(label)
    unit = unit[1:-1] if unit.startswith("(") and unit.endswith(")") else unit
    return f"{_text(symbol)} / {_unit(unit)}"


def _cell(text: str) -> str:
    """A cell in LaTeX: a number with its uncertainty, a number, or words with numbers."""
    ascii_text = text.replace("−", "-")
    if match := _NUMBER_WITH_U.fullmatch(ascii_text):
        value, u, exponent = match.groups()
        return rf"\num{{{value} +- {u}{_power(exponent)}}}"
    if match := _PLAIN_NUMBER.fullmatch(ascii_text):
        return rf"\num{{{match[1]}{_power(match[2])}}}"
    return _text(text)


def _power(exponent: str | None) -> str:
    return "" if exponent is None else f" e{exponent.translate(_SUPERSCRIPT_VALUES)}"


def _unit(text: str) -> str:
    """A unit by siunitx's names; as text if siunitx has no name for it."""
    try:
        return rf"\unit{{{_siunitx(text)}}}"
    except (ConfigurationError, KeyError):
        # a power that is a parameter (`rad⁻ᵖ`) is for siunitx, too
        match = re.fullmatch(rf"([A-Za-z]+)([{_SUPERSCRIPT}ᵖ]+)", text)
        return rf"\unit{{{match[1]}^{{{match[2].translate(_SUPERSCRIPT_VALUES)}}}}}" if match else _text(text)


def _siunitx(unit: str) -> str:
    """A unit by siunitx's names; raises ConfigurationError if it is no unit, KeyError without a name."""
    commands = []
    for symbol, power in factors(unit):
        prefix, rest = split_prefix(symbol.replace("μ", "u").replace("µ", "u"))
        # kilogram is the only unit with its prefix in its name
        command = "".join(f"\\{name}" for name in (_PREFIXES.get(prefix), _UNITS[rest]) if name)
        command = command.replace(r"\kilo\gram", r"\kilogram")
        exponent = power if power.denominator == 1 else float(power)
        commands.append(command if power == 1 else rf"{command}\tothe{{{exponent}}}")
    return "".join(commands)


def _text(text: str) -> str:
    """Words in LaTeX, with symbols and powers in mathematics."""
    parts = []
    # every second part is the exponent of a power of ten
    for index, part in enumerate(re.split(_POWER_OF_TEN, text)):
        if index % 2:
            parts.append(rf"$\times 10^{{{part.translate(_SUPERSCRIPT_VALUES)}}}$")
        else:
            parts += map(_piece_text, _PIECE.findall(part))
    return "".join(parts)


def _piece_text(piece: str) -> str:
    """A letter with its bar and subscript, an exponent, or a character, in LaTeX."""
    if piece[0] in f"{_SUPERSCRIPT}ᵖ":
        return f"$^{{{piece.translate(_SUPERSCRIPT_VALUES)}}}$"
    letter, subscript = piece[0], piece[1:].translate(_SUBSCRIPT_VALUES)
    symbol = f"\\{_GREEK[letter]}" if letter in _GREEK else letter
    if len(piece) > 1:
        symbol = rf"\bar{{{symbol}}}" if "\u0304" in subscript else symbol
        subscript = subscript.replace("\u0304", "")
        return f"${symbol}_{{{subscript}}}$" if subscript else f"${symbol}$"
    return f"${symbol}$" if letter in _GREEK else _CHARACTERS.get(piece, piece)
