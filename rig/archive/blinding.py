"""`rig archive blind`: which columns are hidden, and by how much they could be wrong."""

from collections.abc import Sequence
from pathlib import Path

from processing.errors import ConfigurationError
from rig.archive.blind import seal, seal_folders, sealed
from rig.archive.columns import COLUMNS, PARAMETERS
from rig.archive.store import Archive, reads_archive

_FOLLOWING = ("surface_energy_table2_j_per_m2", "surface_energy_eq2_j_per_m2", "contact_radius_m")
"""What follows from the parameters and would tell them."""


@reads_archive
def blind_runs(archive: Path, columns: Sequence[str], folders: Sequence[Path] = ()) -> str:
    """Hide columns (none named: all parameters of the laws, and what follows from them); says which.

    In `folders`, and below them, all that is found of records is sealed from now on; further ones may follow
    while the archive is blind.

    The offsets are drawn for each rig, over three times what a column scatters or is uncertain by. What has
    no value yet is multiplied by up to two, or divided, when it has.

    Raises ConfigurationError for a column without uncertainty.
    """
    for name in columns:
        if f"u_{name}" not in COLUMNS:
            raise ConfigurationError(
                f"{name}: is not a column with an uncertainty; docs/reference/archive.md lists them"
            )
    store = Archive(archive)
    store.begin()
    if folders and sealed(archive) is not None:
        return seal_folders(archive, folders)
    return seal(archive, _scales(store, columns), folders)


def _scales(store: Archive, columns: Sequence[str]) -> dict[str, float | None]:
    scales: dict[str, float | None] = {}
    try:
        connection = store.connection(within=True)
    except ConfigurationError:
        # nothing was added yet: the best time to do it
        return dict.fromkeys(columns or (*PARAMETERS, *_FOLLOWING))
    for name in columns or (*PARAMETERS, *_FOLLOWING):
        spread, u = connection.execute(
            f"select stddev_samp({name}), median(u_{name}) from runs where isfinite({name})"
        ).fetchone()
        scales[name] = max(spread or 0.0, u or 0.0) or None
    return scales
