"""Every mutation is another program, and no word that a person reads is changed."""

import ast
from pathlib import Path

import pytest

from tests.mutants.__main__ import there
from tests.mutants.mutations import mutations
from tests.mutants.nearest import nearest_first, room_of_tests

SOURCE = b'''"""Adds 1 < 2."""
from dataclasses import dataclass

LIMIT: float | None = 2.5
"""More than 1."""


@dataclass(frozen=True)
class Sum:
    """1 + 1."""

    def of(self, a: int | None, b: "float") -> float:
        if a is None or not b > 0:
            raise ValueError(f"{a:.3f}: 1 is needed" + " - or 2")
        return min(-a * b, LIMIT)
'''


def test_each_place_is_changed_by_itself_and_words_by_none() -> None:
    changed = [mutation.applied(SOURCE).decode() for mutation in mutations(SOURCE)]
    lines = {
        line.strip()
        for text in changed
        for line in set(text.splitlines()) - set(SOURCE.decode().splitlines())
    }
    assert lines == {
        "LIMIT: float | None = 5.0",
        "if a is not None or not b > 0:",
        "if a is None and not b > 0:",
        "if a is None or b > 0:",
        "if a is None or not b >= 0:",
        "if a is None or not b < 0:",
        "if a is None or not b > 1:",
        "if False:",
        "return max(-a * b, LIMIT)",
        "return min(a * b, LIMIT)",
        "return min(-a / b, LIMIT)",
    }


@pytest.mark.slow
@pytest.mark.parametrize("module", ["processing/swing/arc.py", "rig/control/firmware/core.py"])
def test_mutated_modules_are_programs(module: str) -> None:
    source = Path(module).read_bytes()
    found = mutations(source)
    assert len(found) > 150
    for mutation in found[::9]:
        assert ast.dump(ast.parse(mutation.applied(source))) != ast.dump(ast.parse(source))


def test_the_nearest_tests_come_first() -> None:
    assert room_of_tests(Path("rig/control/lasers/obis.py")) == Path("tests/rig/control/lasers")
    assert room_of_tests(Path("rig/control/firmware/core.py")) == Path("tests/rig/control")
    files = nearest_first(Path("processing/fit/whiteness.py"), "whiteness")
    assert files[0] == Path("tests/processing/fit/test_whiteness.py")
    assert set(files) == set(Path("tests/processing/fit").rglob("test_*.py"))


def test_a_test_written_meanwhile_catches_nothing(tmp_path: Path) -> None:
    """Five mutations were "caught: file or directory not found" by a test that the copy did not have."""
    before, since = Path("tests/test_before.py"), Path("tests/test_since.py")
    (tmp_path / before).parent.mkdir()
    (tmp_path / before).touch()
    assert there(tmp_path, [before, since]) == [before]
