"""Calibrations on disk are read back as they were, whatever their values hold."""

import datetime
import math
import tomllib
from pathlib import Path

import pytest

from calibration import parse_calibration, toml_value
from processing.errors import ConfigurationError

NOON = datetime.datetime(2026, 1, 31, 12, 0, 5, 0, datetime.timezone(datetime.timedelta(hours=9)))


@pytest.mark.parametrize(
    ("value", "read"),
    [
        (NOON.replace(microsecond=250_000), NOON),
        (Path("a") / "b", "a/b"),
        (True, True),
        (7, 7),
        (0.1 + 0.2, 0.1 + 0.2),
        (1e-300, 1e-300),
        (-math.inf, -math.inf),
        ('quoted "so", \x7f, \t and µ', 'quoted "so", \x7f, \t and µ'),
        ({"a b": 1.0, "left out": None}, {"a b": 1.0}),
        ([1, [2.5, "three"]], [1, [2.5, "three"]]),
    ],
)  # fmt: skip
def test_what_is_written_is_read_by_another_reader(value: object, read: object) -> None:
    assert tomllib.loads(f"key = {toml_value(value)}")["key"] == read


def test_a_fault_in_a_list_is_placed_by_counting_from_1() -> None:
    made = "made_at = 2026-01-31T12:00:00Z\nvalid_until = 2027-01-31T12:00:00Z\n"
    source = '[[sources]]\nname = "a"\nsha256 = '
    text = f'kind = "lever"\nmeasured_at = 2026-01-31T12:00:00Z\n{made}{source}"{64 * "0"}"\n{source}"b"\n'
    with pytest.raises(ConfigurationError, match=r"\(sources 2: sha256 = 'b': should be text like"):
        parse_calibration(text.encode(), "lever.toml")


def test_what_toml_has_no_value_for_is_refused() -> None:
    with pytest.raises(TypeError, match="complex cannot be written in TOML"):
        toml_value(1j)
