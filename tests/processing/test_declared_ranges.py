"""Values that come from outside are declared with their ranges, and what is assumed lies within them."""

from dataclasses import MISSING, fields

import pytest

from processing.balance.balance import BalanceLimits
from processing.contact import Material
from processing.spot import SensorModel


@pytest.mark.parametrize("kind", [BalanceLimits, Material, SensorModel])
def test_what_is_assumed_lies_within_its_range(kind: type) -> None:
    ranged = 0
    for field in fields(kind):
        for name, holds in (
            ("gt", lambda value, limit: value > limit),
            ("ge", lambda value, limit: value >= limit),
            ("lt", lambda value, limit: value < limit),
        ):
            if name in field.metadata and field.default is not MISSING:
                ranged += 1
                assert holds(field.default, field.metadata[name]), field.name
    assert ranged
