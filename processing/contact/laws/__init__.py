"""The contact laws as data: parameters, moments, coordinates and start values.

To add a law, write a module in this package and list it here.
"""

from collections.abc import Mapping
from types import MappingProxyType

from processing.contact.law import AMPLITUDE, DRAG, TIME, Law
from processing.contact.laws.paper import PAPER, STIFFNESS, elastic_moment, scaled_contact, turning_points_of
from processing.contact.laws.textbook import COULOMB, DAHL, MASING, MAXWELL_SLIP, VISCOUS

LAWS: Mapping[str, Law] = MappingProxyType(
    {
        law.name: law
        for law in (
            PAPER,
            MASING,
            MAXWELL_SLIP,
            DAHL,
            COULOMB,
            VISCOUS,
        )
    }
)  # fmt: skip
"""Laws by name, in the order of display."""

DEFAULT_LAW = PAPER
"""The law that is fitted where no other is named, and whose parameters results report."""
