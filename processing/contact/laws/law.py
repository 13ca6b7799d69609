"""What a law of the contact is to the rest of the program: its parameters and how they are computed."""

from dataclasses import dataclass, field
from math import inf


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number that a fit determines.

    Attributes
    ----------
    key
        Name in results.json; it ends in the SI unit, if there is one.
    symbol, unit
        As printed in tables and figures; the unit is the SI unit, "1" for a plain number.
    lower, upper
        Range in which a value makes sense. An interval is not extended beyond it; a fit may still
        return a value below a lower limit of 0, so that a quantity that is truly 0 is estimated
        without bias.
    logarithmic
        The scatter of a positive value is nearly normal in its logarithm, not in the value itself:
        intervals are taken about the logarithm.
    """

    key: str
    symbol: str
    unit: str
    description: str
    source: str
    lower: float = -inf
    upper: float = inf
    logarithmic: bool = False


DRAG = Parameter(
    "drag_s",
    "drag",
    "s",
    "linear drag: the moment is -m g R drag_s phi'",
    "not in the paper; beside Eq. 1",
)
"""A linear drag, which every law may have in addition."""

AMPLITUDE = Parameter(
    "initial_amplitude_rad", "α₀", "rad", "amplitude of the first turning point", "initial value", lower=0.0
)
TIME = Parameter(
    "start_time_s", "t₀", "s", "time of the first turning point on the clock of the data", "initial value"
)
"""`AMPLITUDE` and `TIME` are fitted with every law; they describe the run, not the contact."""


@dataclass(frozen=True)
class Law:
    """One law of the contact.

    Attributes
    ----------
    name
        Key in the registry and in results.json.
    title, source
        For people: what the law says, and where it comes from.
    parameters
        Of the law, in the order in which fits and tables give them.
    uncalibrated
        What takes the place of a parameter where amplitudes are not known as angles (px, V).
    """

    name: str
    title: str
    source: str
    parameters: tuple[Parameter, ...]
    uncalibrated: dict[str, Parameter] = field(default_factory=dict)

    def fitted(self, *, calibrated: bool = True, drag: bool = False) -> tuple[Parameter, ...]:
        """The parameters of a fit, without the initial amplitude and time."""
        replaced = {} if calibrated else self.uncalibrated
        own = tuple(replaced.get(parameter.key, parameter) for parameter in self.parameters)
        return (*own, DRAG) if drag else own

    def keys(self, *, calibrated: bool = True, drag: bool = False) -> tuple[str, ...]:
        """Names of `fitted`."""
        return tuple(parameter.key for parameter in self.fitted(calibrated=calibrated, drag=drag))

    def parameter(self, key: str) -> Parameter:
        """Any parameter of a fit of this law by its key.

        Raises
        ------
        KeyError
            The law has no such parameter.
        """
        known = (*self.parameters, *self.uncalibrated.values(), DRAG, AMPLITUDE, TIME)
        return {parameter.key: parameter for parameter in known}[key]
