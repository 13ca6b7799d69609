"""Which tests judge a module: those of its room, the nearest files first."""

import os
import re
from pathlib import Path

import pytest

ORDER = "MUTANTS_TEST_FILES"
"""The environment variable with the files in the order in which they are to run."""


def room_of_tests(module: Path) -> Path:
    """The folder of tests that mirrors the module's, or the nearest above it; both relative to the tree."""
    folder = Path("tests") / module.parent
    while not any(folder.glob("test_*.py")) and not any(folder.glob("*/test_*.py")):
        folder = folder.parent
    return folder


def nearest_first(module: Path, within: str) -> list[Path]:
    """Test files of the room: those named after the module first, then those that speak of it."""
    code = module.read_text(encoding="utf-8")
    defined = set(re.findall(r"^(?:def|class) (\w+)", code, re.MULTILINE))
    own = {word for word in module.stem.split("_") if len(word) > 2}
    dotted = ".".join(module.with_suffix("").parts)

    def nearness(test: Path) -> tuple[int, int]:
        text = test.read_text(encoding="utf-8")
        words = set(re.findall(r"\w+", text))
        named = len(own & set(test.stem.split("_"))) / len(own) if own else 0.0
        score = 4 * named + 3 * (within in words) + 3 * (dotted in text) + len(defined & words) / 2
        return -round(100 * score), len(text)

    return sorted(room_of_tests(module).rglob("test_*.py"), key=nearness)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Called by pytest, of which this is a plugin here: the order stated, whatever else sorts the tests."""
    order = {Path(name).resolve(): rank for rank, name in enumerate(os.environ[ORDER].split(os.pathsep))}
    items.sort(key=lambda item: order.get(item.path, len(order)))
