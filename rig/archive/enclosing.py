"""Values of blind runs as an archive stores them: encrypted for the key of its seal, in one column."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rig.archive.blind import Seal
from rig.archive.catalogue import FROM_RESULTS
from rig.archive.columns import COLUMNS
from rig.archive.shelf import table_of
from rig.sealing import disclosed, enclosed

_KEPT = ("chi2_per_dof", "mass_kg", "ball_radius_m")
"""Numbers of results that tell nothing of a parameter."""
_COUNTS = ("half_cycles", "frames")
"""They tell the period, beside the duration."""
_TEXTS = ("problem",)
"""Lines that may name a number."""
SEALED_COLUMNS = [name for name in FROM_RESULTS if name not in ("sealed", "version")]
"""What a seal of a run may hold."""


def withheld(seal: Seal) -> list[str]:
    """Columns of a blind archive that are shown empty: what they hold tells a hidden value."""
    numbers = [
        name
        for name in ("initial_amplitude", "final_amplitude", *FROM_RESULTS)
        if COLUMNS[name].kind == "number"
        and name not in seal.scales
        and name not in _KEPT
        and not name.startswith("u_")
    ]
    return [*dict.fromkeys(numbers), *(_COUNTS if "period0_s" in seal.scales else ())]


def enclosed_row(row: Mapping[str, Any], public_key: str, seal_columns: Iterable[str]) -> dict[str, Any]:
    """A row with its hidden values sealed; one that is sealed already, and one that has none, as it is."""
    hides = [*seal_columns, *(name for name in _TEXTS if re.search(r"\d", row.get(name) or ""))]
    values = {name: row[name] for name in hides if row.get(name) is not None}
    if row.get("sealed") or not values:
        return dict(row)
    open_ = {name: value for name, value in row.items() if name not in values}
    return {**open_, "sealed": enclosed(json.dumps({"row": values}).encode(), public_key)}


def disclosed_table(texts: Sequence[str], keys: Sequence[bytes]) -> Any:
    """What seals hold that one of these keys reads, as an Arrow table with the column `sealed`."""
    rows = []
    for text in texts:
        data = disclosed(text, keys)
        if data is not None:
            rows.append({"sealed": text, **_row(json.loads(data))})
    return table_of(rows, {name: COLUMNS[name] for name in ("sealed", *SEALED_COLUMNS)})


def _row(said: Mapping[str, Any]) -> dict[str, Any]:
    if "row" in said:
        return dict(said["row"])
    # reading results takes seconds to import, for which `list` waits only where it must
    from rig.analysis import disclosed_run
    from rig.archive.session_rows import row_of_results

    row = row_of_results(disclosed_run(said))
    return {name: value for name, value in row.items() if name in SEALED_COLUMNS}
