"""Numbers of the desk have the digits that matter: those of the limit, or of the uncertainty."""

from rig.desk.panels.balance import fault_bars


def test_a_fraction_of_the_balance_is_in_per_cent_as_its_limit_is() -> None:
    fault = {"name": "leakage", "value": 0.0056707, "u_value": 1.8e-6, "limit": 0.01, "unit": "", "ok": True}
    unknown = {**fault, "value": None, "u_value": None, "ok": None}
    bars = fault_bars([{**fault, "meaning": ""}, {**unknown, "meaning": ""}], [unknown, fault])
    assert [(bar.text, bar.note) for bar in bars] == [
        ("go +0.57 %", "limit 1 %; before: not known"),
        ("? not known", "limit 1 %; before: +0.57 %"),
    ]
