"""Units of angles: rad in all calculations, arcsec where values are displayed."""

import math

ARCSEC_RAD = math.pi / 648000.0
"""One arcsec in rad."""
