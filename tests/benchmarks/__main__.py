"""All benchmarks, one after the other: ``python -m tests.benchmarks [--quick] [NAME...]``.

Writes build/bench.json. Speeds are ratios of things measured in the same run; a benchmark that
cannot run here says why and the others go on.
"""

import argparse
import importlib
import json
import platform
import sys
import time
from pathlib import Path
from typing import Any

from tests.benchmarks.cases import show
from tests.orphans import leave_no_orphans
from tests.signals import heed_signals

FOLDER = Path(__file__).parent


def main() -> int:
    """Run what is asked for (everything, without names) and write the numbers."""
    known = sorted(path.stem.removeprefix("bench_") for path in FOLDER.glob("bench_*.py"))
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one or more of {', '.join(known)}")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions, to see that it runs")
    words = parser.parse_args()
    quick: bool = words.quick
    wanted: list[str] = words.names
    if unknown := set(wanted) - set(known):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    names = wanted or known
    leave_no_orphans()
    heed_signals()
    results: dict[str, Any] = {
        "machine": platform.platform(),
        "python": platform.python_version(),
        "quick": quick,
    }
    failed = []
    for name in names:
        print(f"\n== {name}", flush=True)
        began_s = time.monotonic()
        try:
            results[name] = importlib.import_module(f"tests.benchmarks.bench_{name}").run(quick=quick)
            show(results[name])
        except Exception as error:
            failed.append(name)
            results[name] = {"not measured": f"{type(error).__name__}: {error}"}
            print(f"not measured: {type(error).__name__}: {error}")
        print(f"({time.monotonic() - began_s:.0f} s)")
    target = Path("build") / "bench.json"
    target.parent.mkdir(exist_ok=True)
    merged = json.loads(target.read_text()) if wanted and target.exists() else {}
    target.write_text(json.dumps({**merged, **results}, indent=2) + "\n")
    print(f"\n{target}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
