"""Boots a Debian kernel in QEMU with the files of this machine, and runs a Python program in it.

No disk image is made: the kernel's own modules go into a small initramfs, and the root of this
machine is shared read-only over 9p. Without KVM the guest runs about ten times slower.
"""

import fcntl
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[2]
KERNEL_FOLDER = PROJECT / "build" / "kernel"
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "vhci-hcd", "vivid", "usbtmc")
DRIVE_MODULES = ("virtio_pci", "9pnet_virtio", "9p", "virtio_blk", "loop", "ext4", "crc32c_generic", "exfat")
MARK = "RESULT "

INIT = """#!/bin/busybox sh
export PATH=/bin
busybox mkdir -p /proc /sys /dev /host
busybox mount -t proc proc /proc
busybox mount -t sysfs sys /sys
busybox mount -t devtmpfs dev /dev
while read module; do busybox insmod "/modules/$module"; done < /modules/order
busybox mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288,cache=loose,ro host /host
for place in proc sys dev; do busybox mount --bind /$place /host/$place; done
busybox mount -t tmpfs tmp /host/tmp
busybox chroot /host /bin/sh -c "$(busybox cat /command)"
busybox poweroff -f
"""


class Missing(Exception):
    """What the machine lacks, in words."""


def find_kernel() -> tuple[Path, Path]:
    """(kernel image, folder of its modules); fetched with apt where there is none yet."""
    folder = Path(os.environ.get("RIG_TEST_KERNEL", KERNEL_FOLDER))
    folder.parent.mkdir(parents=True, exist_ok=True)
    # two workers may come here at once; a half unpacked kernel boots without the modules it needs
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not list(folder.glob("boot/vmlinuz-*")):
            fetch_kernel(folder)
        image = sorted(folder.glob("boot/vmlinuz-*"))[-1]
        version = image.name.removeprefix("vmlinuz-")
        modules = folder / "lib" / "modules" / version
        if not (modules / "modules.dep").exists():
            subprocess.run(["depmod", "-b", str(folder), version], check=True, capture_output=True)
    return image, modules


def fetch_kernel(folder: Path) -> None:
    """Debian's kernel package, downloaded and unpacked, not installed."""
    if not shutil.which("apt-get") or not shutil.which("dpkg"):
        raise Missing(f"no kernel in {folder}, and no apt-get to fetch Debian's; set RIG_TEST_KERNEL")
    listed = subprocess.run(["apt-cache", "depends", "linux-image-amd64"], capture_output=True, text=True)
    names = [line.split()[-1] for line in listed.stdout.splitlines() if "Depends:" in line]
    if not names:
        raise Missing("apt knows no package linux-image-amd64; run apt-get update, or set RIG_TEST_KERNEL")
    folder.mkdir(parents=True, exist_ok=True)
    got = subprocess.run(["apt-get", "download", names[0]], cwd=folder, capture_output=True, text=True)
    packages = sorted(folder.glob("linux-image-*.deb"))
    if got.returncode or not packages:
        raise Missing(f"the package {names[0]} can't be downloaded: {got.stderr.strip()[-200:]}")
    subprocess.run(["dpkg", "-x", str(packages[-1]), str(folder)], check=True)
    packages[-1].unlink()


def check_tools() -> None:
    """Raise `Missing` where a program is not installed."""
    if PROJECT.is_relative_to("/tmp"):
        raise Missing(f"{PROJECT}: the guest has a /tmp of its own; put the checkout elsewhere")
    for program, package in (
        ("qemu-system-x86_64", "qemu-system-x86"),
        ("busybox", "busybox-static"),
        ("cpio", "cpio"),
        ("depmod", "kmod"),
    ):
        if not shutil.which(program):
            raise Missing(f"{program} is not installed (Debian: apt install {package})")


def module_files(modules: Path, wanted: Sequence[str]) -> list[Path]:
    """The modules that are needed, each after those that it needs itself."""
    needs: dict[str, list[str]] = {}
    for line in (modules / "modules.dep").read_text().splitlines():
        file, _, others = line.partition(":")
        needs[file] = others.split()
    by_name = {Path(file).name.split(".ko")[0]: file for file in needs}
    order: list[str] = []
    for name in wanted:
        if name in by_name:
            for file in (*reversed(needs[by_name[name]]), by_name[name]):
                if file not in order:
                    order.append(file)
    return [modules / file for file in order]


def make_initramfs(folder: Path, modules: Path, wanted: Sequence[str], command: str) -> Path:
    """Busybox, the modules and the command to be run."""
    tree = folder / "initramfs"
    shutil.rmtree(tree, ignore_errors=True)
    (tree / "bin").mkdir(parents=True)
    (tree / "modules").mkdir()
    busybox = shutil.which("busybox")
    assert busybox is not None
    shutil.copy(busybox, tree / "bin" / "busybox")
    files = module_files(modules, wanted)
    for file in files:
        shutil.copy(file, tree / "modules" / file.name)
    (tree / "modules" / "order").write_text("".join(f"{file.name}\n" for file in files))
    (tree / "command").write_text(command)
    init = tree / "init"
    init.write_text(INIT)
    init.chmod(0o755)
    listing = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
    archive = folder / "initramfs.cpio"
    with archive.open("wb") as output:
        subprocess.run(
            ["cpio", "-o", "-H", "newc", "--quiet"],
            cwd=tree,
            input=listing.encode(),
            stdout=output,
            check=True,
        )
    return archive


def python_command(program: str) -> str:
    """What a shell in the guest runs for a module of this project and its arguments.

    Nothing is compiled there: on an emulated processor that takes longer than all the rest.
    """
    return (
        f"cd {PROJECT} && HOME=/tmp OMP_NUM_THREADS=1 NUMBA_DISABLE_JIT=1 PYTHONDONTWRITEBYTECODE=1 "
        f"PATH=/usr/bin:/bin {sys.executable} -m {program} 2>&1"
    )


def start_guest(
    command: str, folder: Path, wanted: Sequence[str] = MODULES, *more: str
) -> subprocess.Popen[bytes]:
    """QEMU with a command of the shell; what it prints goes to `guest.log` in `folder`.

    `wanted` are modules of the kernel, `more` further arguments of QEMU. Raises `Missing`.
    """
    check_tools()
    image, modules = find_kernel()
    initramfs = make_initramfs(folder, modules, wanted, command)
    arguments = [
        *("qemu-system-x86_64", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "1500"),
        *("-nographic", "-no-reboot", "-nodefaults", "-serial", "stdio"),
        *("-kernel", str(image), "-initrd", str(initramfs)),
        *("-append", "console=ttyS0 quiet panic=-1 mitigations=off no_timer_check"),
        *("-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"),
        *more,
    ]
    with (folder / "guest.log").open("wb") as output:
        return subprocess.Popen(arguments, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT)


def result_of(guest: subprocess.Popen[bytes], folder: Path, timeout_s: float) -> dict[str, Any]:
    """What the guest prints as its result. Raises RuntimeError with its last words if it prints none."""
    try:
        guest.wait(timeout_s)
    except subprocess.TimeoutExpired:
        pass
    finally:
        guest.kill()
        guest.wait()
    text = (folder / "guest.log").read_text(errors="replace")
    for line in text.splitlines():
        if line.startswith(MARK):
            result: dict[str, Any] = json.loads(line[len(MARK) :])
            return result
    raise RuntimeError(f"the guest gave no result within {timeout_s:.0f} s:\n{text[-4000:]}")


def run_in_guest(program: str, folder: Path, timeout_s: float) -> dict[str, Any]:
    """Run a module of this project in the guest; what it prints as its result comes back.

    Raises
    ------
    Missing
        QEMU or a kernel is not to be had here.
    RuntimeError
        The guest ended without a result; the message has its last words.
    """
    return result_of(start_guest(python_command(program), folder), folder, timeout_s)
