"""Somebody at the simulated rig who does what the advice says."""

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.weights import TrimmedPendulum, TrimWeight, imperfect_weights
from processing.balance import Turn
from rig.instrument import DIRECTIONS, WEIGHTS
from rig.settings import Configuration

_LEAST_SWING_ARCSEC = 10.0


class SimulatedOperator:
    """Turns the weights of the simulated pendulum and lets it swing.

    Its weights deviate at random from their drawings (`seed`) unless `weights` are given.
    """

    def __init__(
        self, config: Configuration, seed: int, weights: dict[str, TrimWeight] | None = None
    ) -> None:
        if weights is None:
            settings = {name: getattr(config.balance, f"weight_{name}") for name in WEIGHTS}
            nominal = {
                name: TrimWeight(weight.mass_kg, weight.pitch_m, DIRECTIONS[name])
                for name, weight in settings.items()
            }
            weights = imperfect_weights(nominal, seed)
        self._pendulum = TrimmedPendulum(config.simulation, weights, seed=seed)
        self._usual_arcsec = self._swing_arcsec = config.simulation.release.amplitude_arcsec

    @property
    def simulation(self) -> SimulationSettings:
        """The simulated rig as it is now."""
        settings = self._pendulum.settings
        release = settings.release.model_copy(update={"amplitude_arcsec": self._swing_arcsec})
        return settings.model_copy(update={"release": release})

    def follow(self, turn: Turn) -> None:
        """Turn a weight, then let the pendulum swing no more than the advice allows."""
        for part in turn.parts:
            self._pendulum.turn(turn.weight, part)
        self._swing_arcsec = min(self._usual_arcsec, turn.swing_arcsec)

    def swing_less(self) -> bool:
        """Half the amplitude; False if it is small already."""
        if self._swing_arcsec <= _LEAST_SWING_ARCSEC:
            return False
        self._swing_arcsec = max(0.5 * self._swing_arcsec, _LEAST_SWING_ARCSEC)
        return True
