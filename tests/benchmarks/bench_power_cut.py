"""What a power cut leaves of a record, at 50 moments on ext4 and on exFAT, with a guest in QEMU."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tests.kernel.boot import Missing
from tests.kernel.power_cuts import KINDS, cut_power


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` cuts at 5 moments."""
    cuts, duration_s = (5, 8.0) if quick else (50, 40.0)
    results: dict[str, Any] = {}
    for kind in KINDS:
        with tempfile.TemporaryDirectory() as name:
            try:
                results |= _of_one(kind, Path(name), cuts, duration_s)
            except Missing as missing:
                results[f"{kind}: not measured"] = str(missing)
    return results


def _of_one(kind: str, folder: Path, cuts: int, duration_s: float) -> dict[str, Any]:
    records = cut_power(kind, folder, cuts, duration_s)
    read = [record for record in records if "refused" not in record.found]
    lost_s = [record.lost_s for record in read]
    return {
        f"{kind}: cuts": len(records),
        f"{kind}: readable": len(read),
        f"{kind}: refused, with the writes lost before": [
            (record.found["refused"], record.writes_lost) for record in records if "refused" in record.found
        ],
        f"{kind}: with gaps": sum(not record.found["without gaps"] for record in read),
        f"{kind}: wrong after recovery": sum(bool(record.found["wrong after recovery"]) for record in read),
        f"{kind}: lost, median, s": float(np.median(lost_s)) if lost_s else np.nan,
        f"{kind}: lost, most, s": max(lost_s, default=np.nan),
        f"{kind}: writes in the cache, kept": sum(record.writes_kept for record in records),
        f"{kind}: writes in the cache, lost": sum(record.writes_lost for record in records),
    }
