"""Nothing reads back what was put into words: states are told apart by values, texts are only shown."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

_ROOT: Final = Path(__file__).resolve().parents[2]
_PACKAGES: Final = ("rig", "acquisition", "calibration", "processing")
_PROSE: Final = frozenset(
    {
        "alarm", "doing", "flaw", "headline", "instruction", "line", "measured", "next_step", "note", "notes",
        "opened_text", "output", "progress", "reason", "refusal", "remedy", "said", "sentence", "text",
        "title", "why", "words",
    }
)  # fmt: skip
"""Attributes that hold texts for people."""
_READING: Final = frozenset(
    {
        "endswith", "find", "index", "partition", "removeprefix", "removesuffix", "rpartition", "split",
        "startswith",
    }
)  # fmt: skip
_ALLOWED: Final = {
    "rig/archive/session_rows.py": "the path stands in another column, and is not repeated in the flaw",
    "rig/terminal/verdict.py": "a message states its remedy behind a semicolon",
    "processing/least_squares.py": "scipy raises the same class for every fault",
}
"""Where a text is read all the same, and why."""


_HOLDS_PROSE: Final = re.compile(rf"\.({'|'.join(_PROSE)})\b|str\(error\)")
"""Of files without it no tree is made, which takes some 5 ms each."""


def readings(source: str) -> Iterator[str]:
    """Expressions that take a text for people apart, or compare it with a literal."""
    if not _HOLDS_PROSE.search(source):
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            held = node.func.value
            held = held.value if isinstance(held, ast.Subscript) else held
            if node.func.attr in _READING and _is_prose(held):
                yield ast.unparse(node)
        elif isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            literal = any(isinstance(side, ast.Constant) and side.value not in ("", None) for side in sides)
            if literal and any(map(_is_prose, sides)):
                yield ast.unparse(node)


def _is_prose(node: ast.expr) -> bool:
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "str":
        return any(isinstance(argument, ast.Name) and argument.id == "error" for argument in node.args)
    return isinstance(node, ast.Attribute) and node.attr in _PROSE


@pytest.mark.parametrize("package", _PACKAGES)
def test_no_text_for_people_is_read_back(package: str) -> None:
    found = {
        str(path.relative_to(_ROOT)): list(readings(path.read_text(encoding="utf-8")))
        for path in sorted((_ROOT / package).rglob("*.py"))
    }
    unexpected = {name: read for name, read in found.items() if read and name not in _ALLOWED}
    assert not unexpected, "give what is told apart a value (an enumeration, a field); show the text only"
    needless = [name for name in _ALLOWED if name.startswith(f"{package}/") and not found[name]]
    assert not needless, "these read no text any more"


@pytest.mark.parametrize(
    ("source", "is_read"),
    [
        ("ok = 'interlock closed' in now.text", True),
        ("head = drag.text.split(':')[0]", True),
        ("ended = stops[-1].text.startswith(NOT_ACCEPTED)", True),
        ("told = snapshot.reason == 'stopped by the user'", True),
        ("known = 'no such row' in str(error)", True),
        ("ok = now.interlock_closed", False),
        ("shown = f'{verdict.text}: {drag.p_value}'", False),
        ("quiet = snapshot.alarm == ''", False),
        ("fields = line.split(',')", False),
    ],
)
def test_the_search_finds_what_it_should(source: str, is_read: bool) -> None:
    assert bool(list(readings(source))) is is_read
