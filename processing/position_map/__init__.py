"""Errors of position that are fixed on the sensor, found from a run that passes each place many times."""

from processing.position_map.fixed_pattern import PositionMap
from processing.position_map.search import PositionMapSearch
