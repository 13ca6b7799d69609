"""Units of numbers inside quantities."""

from dataclasses import dataclass
from typing import Annotated

from processing.quantity import PART, PLAIN, with_units
from processing.units import unit_of_name


@dataclass(frozen=True)
class Part:
    """A line of a budget: what it contributes is in the unit of what it belongs to."""

    contribution: Annotated[float, PART]
    share: Annotated[float, PLAIN]


@dataclass(frozen=True)
class Whole:
    drag_s: Part


def test_a_part_has_the_unit_of_what_it_belongs_to() -> None:
    found = {path: unit for path, _, unit in with_units(Whole(Part(0.25, 0.5)), unit_of_name)}
    assert found == {("drag_s", "contribution"): "s", ("drag_s", "share"): "1"}
