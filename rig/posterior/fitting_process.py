"""The process that fits, as its parent sees it."""

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from processing.swing import TurningPoints
from rig.posterior.messages import FittedModel, FittedParameters
from rig.rerun import own_group


class FittingProcess:
    """One process; raises OSError where it cannot be started.

    A process, because a fit in a thread would hold the interpreter's lock, for which the frames would wait.
    """

    def __init__(self, model: FittedModel) -> None:
        project = str(Path(__file__).resolve().parents[2])
        path = os.pathsep.join(part for part in (project, os.environ.get("PYTHONPATH")) if part)
        # one thread: those of linear algebra would wait for one another, busily, on few columns
        one = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", "from rig.posterior.worker import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **one, "PYTHONPATH": path},
            **own_group(),
        )
        self._send(model)

    @property
    def pid(self) -> int:
        return self._process.pid

    def fit(self, points: TurningPoints) -> FittedParameters | None:
        """Fit, and wait for the answer; None if the process has died."""
        self._send(points)
        if self._process.stdout is None:
            return None
        try:
            found: FittedParameters = pickle.load(self._process.stdout)
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):
            return None
        return found

    def kill(self) -> None:
        """End it at once; a `fit` that waits returns None. May be called from any thread."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End it; afterwards it can no longer be asked."""
        self.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()

    def _send(self, message: object) -> None:
        # a broken pipe: the process has died, which the answer tells
        with suppress(OSError, ValueError):
            if self._process.stdin is not None:
                pickle.dump(message, self._process.stdin)
                self._process.stdin.flush()
