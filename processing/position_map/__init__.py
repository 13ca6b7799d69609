"""Fixed-pattern position errors, from a run in which the spot passes each place of the sensor many times."""

from processing.position_map.fixed_pattern import PositionMap
from processing.position_map.search import PositionMapSearch
