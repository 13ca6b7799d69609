"""The pendulum on its ball, and the interface of a contact law: parameters, moments, solver's coordinates."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, NamedTuple

from processing.arrays import Floats, Ints
from processing.contact.half_cycle_table import TABLE_RATIO, PredictedTurningPoints, TableMaker, iterate_decay
from processing.quantity import Quantity

if TYPE_CHECKING:
    from processing.contact.coordinates import Coordinates

STANDARD_GRAVITY_M_PER_S2 = 9.80665  # third CGPM, 1901


@dataclass(frozen=True, slots=True)
class ContactParameters:
    """The six parameters of Eqs. 1, 3 and 6, angles in rad."""

    b: float
    """Factor of the friction of Eq. 1, in rad^-p."""
    p: float
    c: float
    """Constant friction of Eq. 1, a moment over m g R."""
    n: float
    """Exponent of the elastic adhesion of Eq. 3."""
    period0_s: float
    """Period at vanishing amplitude."""
    gamma_pa: float
    """Stiffness of the elastic adhesion of Eq. 3."""
    drag_s: float = 0.0
    """Linear drag, whose moment is ``-m g R drag_s phi'``."""


@dataclass(frozen=True, slots=True)
class PendulumOnBall:
    """Mass, ball radius and contact spot used by the fits."""

    mass_kg: float
    ball_radius_m: float
    contact_radius_m: float
    """Hertz's radius a."""
    gravity_m_per_s2: float = STANDARD_GRAVITY_M_PER_S2


def stiffness_ratio(gamma_pa: float, pendulum: PendulumOnBall) -> float:
    """Factor of the adhesive moment divided by m g R, in rad^-n: ``kappa = 2 gamma a^2 / (m g)``."""
    return 2 * gamma_pa * pendulum.contact_radius_m**2 / (pendulum.mass_kg * pendulum.gravity_m_per_s2)


def relative_curvature(pendulum: PendulumOnBall) -> float:
    """R/a of Eq. 3 in rad^-1."""
    return pendulum.ball_radius_m / pendulum.contact_radius_m


def weight_moment(pendulum: PendulumOnBall) -> float:
    """m g R in N m, the unit of the coefficients of Eq. 1."""
    return pendulum.mass_kg * pendulum.gravity_m_per_s2 * pendulum.ball_radius_m


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number that a fit determines."""

    key: str
    """Name in results.json; it ends in the SI unit, if there is one."""
    symbol: str
    unit: str
    """SI unit; "1" for a plain number."""
    description: str
    source: str
    lower: float = -inf
    """Lower end of the values that make sense. An interval is not extended beyond it; a fit may still return
    a value below a limit of 0, so that a quantity that is truly 0 is estimated without bias."""
    upper: float = inf
    logarithmic: bool = False
    """The scatter of a positive value is nearly normal in its logarithm, not in the value itself: intervals
    are taken about the logarithm."""
    shown: str = ""
    """Unit of tables and figures; empty: the SI unit."""

    @property
    def quantity(self) -> Quantity:
        """Symbol, description and units with which it is shown."""
        return Quantity(self.symbol, self.description, self.shown, self.unit)


PERIOD = "period0_s"
"""Key of T0, which every law has."""
FREE_PERIOD = Parameter(
    PERIOD, "T₀", "s", "period without the contact's moment", "I φ'' = -m g R φ", lower=0.0
)
CONSTANT = Parameter("c", "c", "1", "constant friction, over m g R", "M = -m g R c sign(φ')", lower=0.0)

DRAG = Parameter(
    "drag_s",
    "drag",
    "s",
    "linear drag: the moment is -m g R drag_s phi'",
    "not in the paper; beside Eq. 1",
)
"""A linear drag, which can be fitted in addition to any law."""

AMPLITUDE = Parameter(
    "initial_amplitude_rad",
    "α₀",
    "rad",
    "amplitude of the first turning point",
    "initial value",
    lower=0.0,
    shown="arcsec",
)
TIME = Parameter(
    "start_time_s", "t₀", "s", "time of the first turning point on the clock of the data", "initial value"
)
"""`AMPLITUDE` and `TIME` are fitted with every law; they describe the run and not the contact."""


class BranchMoments(NamedTuple):
    """Frictional and elastic moment between one turning point and the next, in N m (Eq. 7)."""

    friction_n_m: Floats
    elastic_n_m: Floats


class HeldColumn(NamedTuple):
    """Column of the solver that is adjusted to hold a parameter at a given value."""

    column: int
    keeps_sign: bool = False
    """Whether the adjustment must not change the column's sign."""


@dataclass(frozen=True)
class Law:
    """One law of the contact."""

    name: str
    """Key in the registry and in results.json."""
    title: str
    source: str
    """Its reference in the literature."""
    parameters: tuple[Parameter, ...]
    """In the order of fits and tables."""
    branch_moments: Callable[[Floats, Floats, Mapping[str, float], PendulumOnBall], BranchMoments]
    """Function of the deflections (rad), the sign of phi', the parameters by key and the pendulum, which
    returns the moments."""
    table: TableMaker
    """Function of the map's parameters without the first amplitude, and of a range of amplitudes, which
    returns the half-cycles in that range."""
    coordinates: Callable[..., "Coordinates"]
    """Function of the turning points, the pendulum, the keys of the fit (`fit_names`) and the start values of
    columns that are not the law's, which returns the solver's coordinates."""

    def turning_points(self, parameters: Floats, numbers: Ints) -> PredictedTurningPoints:
        """Turning points of a free decay, for the map's parameters and rising half-cycle numbers, from 0."""
        first = float(parameters[-1])
        half_cycles = iterate_decay(
            lambda highest: self.table(parameters[:-1], highest, highest / TABLE_RATIO),
            len(parameters),
            first,
            int(numbers[-1]),
        )
        return half_cycles.turning_points(first, numbers)

    def names(self, *, drag: bool = False) -> tuple[str, ...]:
        """Keys of the parameters of a fit, without the initial amplitude and time."""
        own = tuple(parameter.key for parameter in self.parameters)
        return (*own, DRAG.key) if drag and DRAG.key not in own else own

    def fit_names(self, *, drag: bool = False) -> tuple[str, ...]:
        """Keys of all parameters that a fit varies: `names`, then the initial amplitude and time."""
        return (*self.names(drag=drag), AMPLITUDE.key, TIME.key)

    def parameter(self, key: str) -> Parameter:
        """Any parameter of a fit of this law by its key; raises KeyError where there is none."""
        known = (*self.parameters, DRAG, AMPLITUDE, TIME)
        return {parameter.key: parameter for parameter in known}[key]
