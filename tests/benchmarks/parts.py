"""Benchmarks that consist of parts, each for a number of made-up campaigns: run them all, or those named."""

import time
from collections.abc import Callable, Mapping
from typing import Any

Parts = Mapping[str, tuple[Callable[[int], dict[str, float]], int]]
"""By name, what measures a part, and for how many campaigns."""


def run_parts(parts: Parts, *, quick: bool, names: tuple[str, ...], least: int = 1) -> dict[str, Any]:
    """All parts, or those that are named; quick for a twentieth of the campaigns, at least for `least`."""
    results: dict[str, Any] = {}
    for name, (part, count) in parts.items():
        if not names or name in names:
            print(f"{name}:", flush=True)
            began_s, began_cpu_s = time.monotonic(), time.process_time()
            results[name] = part(max(least, count // 20) if quick else count)
            cpu_s = time.process_time() - began_cpu_s
            print(f"  ({time.monotonic() - began_s:.0f} s, {cpu_s:.0f} s of CPU)", flush=True)
    return results
