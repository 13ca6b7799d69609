"""Cuts the power of a guest that records, at many moments, and says what a guest reads afterwards.

One guest records onto a drive with a volatile write cache; at random moments the drive gives out what it
would hold if the power went now. That is all a cut leaves: the guest's memory, page cache included, is not in
it. At the last moment the guest is killed. A second guest mounts each of these drives and copies its record
out, numbers and pixels, which are then read here.
"""

import os
import shutil
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.record import pixels_path
from acquisition.record.check import check_record, recover
from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from tests.kernel.boot import DRIVE_MODULES, Missing, python_command, start_guest
from tests.kernel.guest_recorder import FOLDER, HANDED, RATE_HZ, RECORD
from tests.kernel.volatile_drive import Cut, VolatileDrive

DRIVE_BYTES = 48 * 1024 * 1024
KINDS = {"ext4": ("mkfs.ext4", "-q", "-F"), "exfat": ("mkfs.exfat",)}
BOOT_S = 400.0
_BLOCK_BYTES = 4096
COPIED = "COPIED "


@dataclass(frozen=True)
class CutRecord:
    """What one cut left; `lost_s` is the time from the first frame lost to the cut."""

    lost_s: float
    found: dict[str, Any]
    writes_kept: int
    writes_lost: int


def cut_power(kind: str, folder: Path, cuts: int, duration_s: float, seed: int = 1) -> list[CutRecord]:
    """Record for a time on a file system and cut the power at random moments of it.

    Raises `Missing` where QEMU, a kernel or the file system's program is not to be had.
    """
    program = KINDS[kind][0]
    if not shutil.which(program):
        raise Missing(f"{program} is not installed (Debian: apt install e2fsprogs exfatprogs)")
    image = folder / "drive.img"
    image.write_bytes(bytes(DRIVE_BYTES))
    subprocess.run([*KINDS[kind], str(image)], check=True, capture_output=True)
    rng = np.random.default_rng(seed)
    drive = VolatileDrive(folder / "drive.sock", image.read_bytes())
    try:
        taken = _record(kind, folder, drive, np.sort(rng.uniform(0.2, duration_s, cuts)), rng)
    finally:
        drive.close()
    _write_sparse(folder / "cuts.img", [cut.image for cut, _ in taken])
    found = [_read(folder / "read.mcap", *files) for files in _copied_out(kind, folder, len(taken))]
    return [
        CutRecord(
            # numbers and pixels are two files, each of which is forced to the drive by itself
            (handed + 1 - min(each.get("spots", 0), each.get("windows", 0))) / RATE_HZ,
            each,
            cut.kept,
            cut.lost,
        )
        for (cut, handed), each in zip(taken, found, strict=True)
    ]


def _record(
    kind: str, folder: Path, drive: VolatileDrive, moments_s: np.ndarray, rng: np.random.Generator
) -> list[tuple[Cut, int]]:
    """Of every moment what the drive held, and the first number of a frame said after it."""
    attached = f"driver=nbd,server.type=unix,server.path={folder / 'drive.sock'},if=virtio,cache=none"
    command = python_command(f"tests.kernel.guest_recorder /dev/vda {kind}")
    guest = start_guest(command, folder, DRIVE_MODULES, "-drive", attached)
    log = folder / "guest.log"
    try:
        _wait_for_more(guest, log, -1)
        began_s = time.monotonic()
        taken = []
        for number, moment_s in enumerate(moments_s, start=1):
            time.sleep(max(0.0, began_s + moment_s - time.monotonic()))
            before = _last_handed(log)
            if number == len(moments_s):
                guest.kill()
                guest.wait()
                taken.append((drive.cut(rng), before))
            else:
                cut = drive.cut(rng)
                taken.append((cut, _wait_for_more(guest, log, before)))
    finally:
        guest.kill()
        guest.wait()
    return taken


def _copied_out(kind: str, folder: Path, count: int) -> list[tuple[bytes, bytes]]:
    """Numbers and pixels on each of the cut drives, as a kernel mounts them; empty where it cannot."""
    names = RECORD, pixels_path(Path(RECORD)).name
    copies = folder / "copies.img"
    with copies.open("wb") as file:
        file.truncate(len(names) * count * DRIVE_BYTES)
    attached = [
        word
        for image in (folder / "cuts.img", copies)
        for word in ("-drive", f"file={image},format=raw,if=virtio,cache=unsafe")
    ]
    mount = f"mount -t {kind} -o loop,offset=$((i*{DRIVE_BYTES})),sizelimit={DRIVE_BYTES} /dev/vda {FOLDER}"
    # exFAT has no journal: it may know a file's size without the place of its last clusters
    copy = (
        f"dd if={FOLDER}/$name of=/dev/vdb bs={_BLOCK_BYTES} seek=$((n*{DRIVE_BYTES // _BLOCK_BYTES})) "
        "conv=noerror,sync,notrunc,fsync"
    )
    command = (
        f"export PATH=/usr/sbin:/sbin:/usr/bin:/bin; mkdir -p {FOLDER}; i=0; n=0; "
        f"while [ $i -lt {count} ]; do "
        f"{mount}; for name in {' '.join(names)}; do "
        f'[ -e {FOLDER}/$name ] && {copy} && echo "{COPIED}$n $(stat -c %s {FOLDER}/$name)"; '
        f"n=$((n+1)); done; "
        f"umount {FOLDER}; i=$((i+1)); done"
    )
    guest = start_guest(command, folder, DRIVE_MODULES, *attached)
    try:
        guest.wait(BOOT_S + 5.0 * count)
    finally:
        guest.kill()
        guest.wait()
    said = (folder / "guest.log").read_text(errors="replace").splitlines()
    sizes = dict(map(int, line.split()[1:]) for line in said if line.startswith(COPIED))
    if not sizes:
        raise RuntimeError("the guest copied nothing:\n" + "\n".join(said[-30:]))
    with copies.open("rb") as file:
        files = [
            os.pread(file.fileno(), sizes.get(number, 0), number * DRIVE_BYTES)
            for number in range(len(names) * count)
        ]
    return list(zip(files[::2], files[1::2], strict=True))


def _read(path: Path, numbers: bytes, pixels: bytes) -> dict[str, Any]:
    """How many frames can be read, and what is wrong besides that the files were cut."""
    path.write_bytes(numbers)
    pixels_path(path).write_bytes(pixels)
    copy = path.with_name("copy.mcap")
    for file in (copy, pixels_path(copy)):
        file.unlink(missing_ok=True)
    try:
        with RecordReader(path) as reader:
            spots = reader.spots()["sequence"].tolist()
            windows = [window.sequence for window in reader.windows()]
        recover(path, copy)
        wrong = [finding.text for finding in check_record(copy) if finding.severity == "error"]
    except RecordError as error:
        return {"refused": str(error)}
    whole = spots == list(range(len(spots))) and windows == list(range(len(windows)))
    return {
        "spots": len(spots),
        "windows": len(windows),
        "without gaps": whole,
        "wrong after recovery": wrong,
    }


def _last_handed(log: Path) -> int:
    lines = log.read_text(errors="replace").split("\n")[:-1]
    return max((int(line.split()[1]) for line in lines if line.startswith(HANDED)), default=-1)


def _wait_for_more(guest: subprocess.Popen[bytes], log: Path, before: int) -> int:
    """The next number that the guest says; a cut is never dated too early by what it had not said yet."""
    deadline_s = time.monotonic() + BOOT_S
    while (now := _last_handed(log)) <= before:
        if guest.poll() is not None or time.monotonic() > deadline_s:
            raise RuntimeError(f"the guest does not record:\n{log.read_text(errors='replace')[-4000:]}")
        time.sleep(0.01)
    return now


def _write_sparse(path: Path, images: list[bytes]) -> None:
    """All drives one behind the other; blocks of zeros take no space."""
    zeros = bytes(_BLOCK_BYTES)
    with path.open("wb") as file:
        for number, image in enumerate(images):
            for place in range(0, len(image), _BLOCK_BYTES):
                block = image[place : place + _BLOCK_BYTES]
                if block != zeros:
                    file.seek(number * DRIVE_BYTES + place)
                    file.write(block)
        file.truncate(len(images) * DRIVE_BYTES)
