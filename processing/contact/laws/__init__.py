"""Contact laws as data, one file per law: parameters, moments, half-swing map and start values."""

from processing.contact.law import AMPLITUDE, DRAG, TIME, Law
from processing.contact.laws.paper import PAPER, STIFFNESS, elastic_moment, scaled_contact, turning_points_of
from processing.contact.laws.registry import DEFAULT_LAW, LAWS
