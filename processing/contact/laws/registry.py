"""The laws that a fit may use. To add one: a file beside this one, and its line here."""

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
"""By name, in the order in which they are listed to people."""
