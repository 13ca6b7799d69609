"""The configured pendulum: mass, number of balls, contact radius, materials."""

from processing.contact import Material, PendulumOnBall
from processing.contact import material as material_by_name
from processing.contact import pendulum_on_ball as pendulum_after_hertz
from processing.errors import ConfigurationError
from rig.settings import Configuration


def pendulum_on_ball(config: Configuration) -> PendulumOnBall | None:
    """Mass, ball and contact radius (from Hertz's theory if not stated); None without [pendulum]."""
    pendulum = config.pendulum
    if pendulum is None:
        return None
    # the load of one ball, so that moments and energies are those of one contact
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
    """Number of equal balls that share the weight."""
    return config.instrument.description().supports


def material(config: Configuration, name: str) -> Material:
    """A material by name; those of the configuration take precedence over those of the paper."""
    return material_by_name(name, config.materials)


def check_materials(config: Configuration) -> None:
    """Raise ConfigurationError for an unknown material, before anything is measured."""
    if config.pendulum is not None and config.pendulum.contact_radius_m is None:
        try:
            pendulum_on_ball(config)
        except ConfigurationError as error:
            raise ConfigurationError(f"pendulum: {error} under [materials.NAME]") from None
