"""Registry of the contact laws. To add a law, write a module in this package and list it here."""

from collections.abc import Mapping
from types import MappingProxyType

from processing.contact.law import Law
from processing.contact.laws.paper import PAPER

LAWS: Mapping[str, Law] = MappingProxyType(
    {
        law.name: law
        for law in (
            PAPER,
        )
    }
)  # fmt: skip
"""Laws by name, in the order of display."""
