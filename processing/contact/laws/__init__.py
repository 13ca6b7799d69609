"""Laws of the contact as data: parameters, moment, half-swing map and start values, one file a law."""

from processing.contact.law import AMPLITUDE, DRAG, TIME, Law, Parameter
from processing.contact.laws.paper import PAPER
from processing.contact.laws.registry import LAWS

__all__ = ["AMPLITUDE", "DRAG", "LAWS", "PAPER", "TIME", "Law", "Parameter"]
