"""The Thorlabs driver with a real kernel's usbtmc, in QEMU; the instrument is attached over USB/IP."""

from typing import Any

import pytest

from tests.kernel.scenarios import scenario

GUEST = "guest_usbtmc"
pytestmark = pytest.mark.kernel


def test_a_diode_driver_on_usb_is_found_lit_and_darkened_and_its_loss_is_named(
    results: dict[str, Any],
) -> None:
    seen = scenario(results, "talk")
    assert "0 USBTMC instruments of vendor 1313 fit" in seen["missing"]
    assert seen["identity"] == ["Thorlabs", "ITC4001", "M00277475"]
    assert "cannot open the instrument" in seen["second"]
    assert "there is usbtmc:M00277475" in seen["other"]
    assert seen["lit"]["on"]
    assert seen["lit"]["current_a"] == 0.02
    assert "no reply" in seen["silent"]
    # three questions of half a second each, on a machine that is emulated
    assert seen["silent_s"] < 20.0
    assert not seen["dark"]["on"]
    assert "check the cable" in seen["pulled"]
