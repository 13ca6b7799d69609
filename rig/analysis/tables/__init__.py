"""Tables as other programs write them: files into cells, cells into numbers, headers into units."""

from rig.analysis.tables.cells import Cells, read_cells
from rig.analysis.tables.columns import Columns
from rig.analysis.tables.header_units import known_unit
from rig.analysis.tables.moments import moments_ns
from rig.analysis.tables.runs import Run, runs_of
