"""The pendulum as configured: mass, balls, contact, materials."""

from processing.contact import Material, PendulumOnBall
from processing.contact import material as material_by_name
from processing.contact import pendulum_on_ball as pendulum_after_hertz
from processing.errors import ConfigurationError
from rig.settings import Configuration


def pendulum_on_ball(config: Configuration) -> PendulumOnBall | None:
    """Mass, ball and contact radius (Hertz, where it is not stated); None without [pendulum]."""
    pendulum = config.pendulum
    if pendulum is None:
        return None
    # what one ball carries: moments and energies are then those of one ball
    mass_kg = pendulum.mass_kg / balls(config)
    if pendulum.contact_radius_m is not None:
        return PendulumOnBall(
            mass_kg, pendulum.ball_radius_m, pendulum.contact_radius_m, pendulum.gravity_m_per_s2
        )
    return pendulum_after_hertz(
        mass_kg,
        pendulum.ball_radius_m,
        material(config, pendulum.ball_material),
        material(config, pendulum.flat_material),
        gravity_m_per_s2=pendulum.gravity_m_per_s2,
    )


def balls(config: Configuration) -> int:
    """How many equal balls share the weight."""
    return config.instrument.description().supports


def material(config: Configuration, name: str) -> Material:
    """A material by name, the configuration's own before the paper's."""
    return material_by_name(name, config.materials)


def check_materials(config: Configuration) -> None:
    """Raise ConfigurationError for a material that nobody knows, before anything is measured."""
    if config.pendulum is not None and config.pendulum.contact_radius_m is None:
        try:
            pendulum_on_ball(config)
        except ConfigurationError as error:
            raise ConfigurationError(f"pendulum: {error} under [materials.NAME]") from None
