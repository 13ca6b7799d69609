"""The table of contacts for a paper: LaTeX with siunitx."""

from math import isfinite
from typing import Final

from rig.campaigns.results import CampaignResults
from rig.presentation import quantity, rounded

_SYMBOLS: Final = {
    "b": "b", "p": "p", "c": "c", "n": "n", "period0_s": "T_0", "gamma_pa": r"\gamma", "drag_s": r"d",
    "surface_energy_table2_j_per_m2": r"\sigma",
}  # fmt: skip
_UNITS: Final = {
    "MPa": r"\mega\pascal", "s": r"\second", "ms": r"\milli\second",
    "mJ/m²": r"\milli\joule\per\square\metre",
}  # fmt: skip


def latex_table(results: CampaignResults) -> str:
    """A `tabular` whose numbers are siunitx's, with uncertainties in the digits of the value."""
    names = list(dict.fromkeys(name for values in results.contacts.values() for name in values))
    head = ["contact"]
    for name in names:
        of = quantity(name)
        unit = f" / \\unit{{{_UNITS[of.unit]}}}" if of.unit in _UNITS else ""
        head.append(f"${_SYMBOLS.get(name, of.symbol)}${unit}")
    lines = [
        "% \\usepackage{siunitx, booktabs}; value and standard uncertainty",
        "\\begin{tabular}{l" + "c" * len(names) + "}",
        "\\toprule",
        " & ".join(head) + r" \\",
        "\\midrule",
    ]
    for contact, values in results.contacts.items():
        cells = [_escaped(contact)]
        for name in names:
            found = values.get(name)
            factor = quantity(name).factor
            cells.append(
                "" if found is None else _number(found.value * factor, found.standard_uncertainty * factor)
            )
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", ""])


def _number(value: float, u: float) -> str:
    """`\\num{3.733(10)e-3}`."""
    if not isfinite(value) or not isfinite(u) or u <= 0:
        return "{--}"
    found = rounded(value, u)
    digits = found.u.replace(".", "").lstrip("0")
    exponent = f"e{found.exponent}" if found.exponent else ""
    return f"\\num{{{found.value.replace('−', '-')}({digits}){exponent}}}"


def _escaped(text: str) -> str:
    return "".join(f"\\{sign}" if sign in "&%$#_{}" else sign for sign in text)
