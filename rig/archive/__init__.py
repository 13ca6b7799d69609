"""The commands `rig archive`: the runs of many sessions as rows of one DuckDB file."""

from rig.archive.listing import find_runs, list_runs, ordered_runs, query_runs, show_runs
from rig.archive.updating import add_folders, check_archive, refit_runs, update_archive
