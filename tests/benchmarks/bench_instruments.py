"""Coverage of the stated uncertainties for every kind of pendulum."""

from functools import partial

from tests.benchmarks.cases import run_of
from tests.benchmarks.coverage import Case, measure, of_pulls
from tests.processing.instruments.simulated_instruments import MEASUREMENTS
from tests.rig.analysis.spinning import Held


def cases() -> list[Case]:
    """With 50 runs and three quantities the share of a kind scatters by 4 to 7 %."""

    def found(kind: str, seed: int) -> dict[str, Held]:
        return of_pulls({name: one.pull for name, one in MEASUREMENTS[kind](seed).items()})

    return [Case(kind, partial(found, kind)) for kind in MEASUREMENTS]


run = run_of(measure, cases, seeds=50, quick_seeds=10, apart=0)
