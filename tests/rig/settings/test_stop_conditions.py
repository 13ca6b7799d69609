"""`session.stop_when`: what is read, and what is refused in one line."""

import pytest

from processing.errors import ConfigurationError
from processing.estimate import Estimate
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS


def test_conditions_name_parameters_as_people_write_them() -> None:
    texts = '["u(c)/c < 0.03", "u(gamma)/gamma<1e-3", " u( T0 ) / T₀ < .5"]'.replace(" .5", " 0.5")
    config = load_configuration(CONFIGS / "demo.toml", [f"session.stop_when={texts}"])
    found = [(one.parameter, one.limit) for one in config.stop_conditions]
    assert found == [("c", 0.03), ("gamma_pa", 1e-3), ("period0_s", 0.5)]
    condition = config.stop_conditions[0]
    assert condition.text({"c": Estimate(1e-8, 2e-10)}) == "u(c)/c = 0.02 < 0.03"
    assert condition.text({"c": Estimate(-1e-8, 1e-9)}) == "u(c)/c = 0.1 ≥ 0.03"
    assert condition.text({}) == "u(c)/c = ? ≥ 0.03"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("c < 0.03", r"'c < 0\.03' must read u\(NAME\)/NAME < NUMBER, for example u\(c\)/c < 0\.03"),
        ("u(c)/c > 0.03", "must read"),
        ("u(c)/c < 3 %", "must read"),
        ("u(z)/z < 0.1", "no parameter z; known are b, p, c, n, T0, gamma, drag"),
        ("u(c)/b < 0.1", r"'u\(c\)/b < 0\.1' names two parameters; write u\(c\)/c"),
        ("u(c)/c < 3", "3 must lie between 0 and 1, 0.03 for 3 %"),
        ("u(c)/c < 0", "0 must lie between 0 and 1"),
        ("u(c)/c < 1.2.3", r"1\.2\.3 is not a number"),
    ],
)
def test_a_wrong_condition_is_one_line(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"session\.stop_when: .*{message}") as caught:
        load_configuration(CONFIGS / "demo.toml", [f'session.stop_when=["{text}"]'])
    assert "\n" not in str(caught.value)


def test_conditions_are_a_list() -> None:
    with pytest.raises(ConfigurationError, match=r"session\.stop_when = 'u\(c\)/c < 0\.03': should be"):
        load_configuration(CONFIGS / "demo.toml", ["session.stop_when=u(c)/c < 0.03"])


def test_a_drag_that_is_not_fitted_ends_no_run() -> None:
    wanted = ['session.stop_when=["u(drag)/drag < 0.1"]']
    assert load_configuration(CONFIGS / "demo.toml", wanted).stop_conditions
    with pytest.raises(ConfigurationError, match=r"session\.stop_when: .*fit\.drag = 'vacuum' fits none"):
        load_configuration(CONFIGS / "demo.toml", [*wanted, "fit.drag=vacuum"])
