"""Compiles the kernels before the tests begin, in two processes, so that no test's limit of time counts it.

A third one looks for the tests: their assertions are rewritten and kept once, instead of by every worker.

A short session compiles what a run and its fit need for pixels of 8 bits; the other process compiles the
tracker for 12 bits, and the equation of motion that tests integrate. What both need is compiled by the one
that comes first.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.rig.command_line import CONFIGS, SMALL, set_words

TWELVE_BITS_AND_MOTION = """
from processing.spot import SensorModel
from rig.instrument.provenance import compile_tracker
compile_tracker(SensorModel(gain_e_per_dn=2.4, read_noise_e=7.0, full_scale_dn=4095.0))
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path
driven_path(*paper_pair("glass_k8"), q=0.0, seed=0, last_arcsec=120.0)
"""


def main() -> None:
    """All processes, of which each must succeed; what failed is shown, and nothing else."""
    with tempfile.TemporaryDirectory() as folder:
        words = set_words({**SMALL, "session.max_duration_s": "70"})
        session = [
            sys.executable,
            "-m",
            "rig",
            "run",
            str(CONFIGS / "demo.toml"),
            "-o",
            f"{folder}/out",
            *words,
        ]
        tests = [sys.executable, "-m", "pytest", "--collect-only", "-qq", "-m", ""]
        programs = [session, [sys.executable, "-c", TWELVE_BITS_AND_MOTION], tests]
        logs = [Path(folder) / f"log-{number}" for number in range(len(programs))]
        running = []
        for program, log in zip(programs, logs, strict=True):
            with log.open("wb") as said:
                running.append(subprocess.Popen(program, stdout=said, stderr=said))
        failed = [log for process, log in zip(running, logs, strict=True) if process.wait()]
        if failed:
            sys.exit("\n".join(log.read_text() for log in failed))


if __name__ == "__main__":
    main()
