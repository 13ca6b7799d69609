"""Replaces characters that a terminal's encoding lacks by ASCII: `x 10^-3` for `× 10⁻³`."""

import codecs
import io
import sys
from typing import Final

_SUPERSCRIPTS: Final = dict(zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹ᵖ", "-0123456789p", strict=True))
_SPELLED: Final = {
    "±": "+-", "×": "x", "−": "-", "–": "-", "…": "...", "°": " deg", "µ": "u", "₀": "0", "ₜ": "t",
    "α": "alpha", "γ": "gamma", "κ": "kappa", "σ": "sigma", "χ": "chi", "ν": "nu", "φ": "phi",
}  # fmt: skip


def spelled(text: str) -> str:
    """The text in ASCII; a character without a replacement becomes a question mark."""
    parts = []
    raised = False
    for character in text:
        if character in _SUPERSCRIPTS:
            parts.append(("" if raised else "^") + _SUPERSCRIPTS[character])
        else:
            parts.append(character if character.isascii() else _SPELLED.get(character, "?"))
        raised = character in _SUPERSCRIPTS
    return "".join(parts)


def spell_out_what_is_missing() -> None:
    """Make stdout and stderr replace characters that their encoding lacks, instead of raising an error."""
    codecs.register_error("spelled", _spell)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="spelled")


def _spell(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return spelled(error.object[error.start : error.end]), error.end
