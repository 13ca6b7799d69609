"""What happens in a guest, scenario by scenario, as a test outside is told it."""

import json
import os
import socket
import subprocess
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.kernel.boot import MARK

VHCI = Path("/sys/devices/platform/vhci_hcd.0")


def attach(serve: Callable[[socket.socket], None], port: int, speed: int, found: Callable[[], object]) -> int:
    """In the guest: plug in a device that lives in a process of its own; returns that process's id."""
    kernel_end, device_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    child = os.fork()
    if child == 0:
        kernel_end.close()
        serve(device_end)
        os._exit(0)
    device_end.close()
    (VHCI / "attach").write_text(f"{port} {kernel_end.fileno()} 65537 {speed}")
    kernel_end.close()
    deadline_s = time.monotonic() + 20
    while not found():
        if time.monotonic() > deadline_s:
            raise TimeoutError("the kernel shows no such device")
        time.sleep(0.1)
    return child


def run_scenarios(scenarios: Mapping[str, Callable[[], dict[str, Any]]], wanted: Sequence[str]) -> None:
    """In the guest: all of them, or those that are wanted; one that fails keeps none from the others."""
    results: dict[str, Any] = {}
    for name in wanted or list(scenarios):
        begin_s = time.monotonic()
        try:
            results[name] = scenarios[name]()
        except BaseException:
            kernel = subprocess.run(["dmesg"], capture_output=True, text=True, check=False).stdout
            results[name] = {"error": traceback.format_exc() + kernel[-3000:]}
        results[name]["seconds"] = time.monotonic() - begin_s
        print(name, results[name], flush=True)
    print("\n" + MARK + json.dumps(results), flush=True)


def scenario(results: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Outside: what one of them has seen; a failure in the guest is one here."""
    result: dict[str, Any] = results[name]
    assert "error" not in result, result["error"]
    return result
