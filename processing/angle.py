"""Angles: rad inside, arcsec where a person reads."""

import math

ARCSEC_RAD = math.pi / 648000.0
"""One arcsec in rad."""
