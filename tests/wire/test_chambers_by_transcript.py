"""The drivers of chambers say what the transcripts say, word for word, and understand what is answered."""

from __future__ import annotations

from typing import Any

import pytest
from scripted import Player, parameters, surroundings

from planrunner.instruments.chambers.espec_p300 import EspecP300
from planrunner.instruments.chambers.thermotron_8800 import Thermotron8800
from planrunner.instruments.chambers.watlow_f4t import WatlowF4t
from planrunner.plan.units import ZERO_CELSIUS

RANGE = ("lowest: -40 degC", "highest: 85 degC", "ramp: 3 K/min", "tolerance: 0.5 K")
DRIVERS: dict[str, Any] = {"watlow_f4t": WatlowF4t, "espec_p300": EspecP300, "thermotron_8800": Thermotron8800}


@pytest.mark.parametrize("name", DRIVERS)
def test_a_chamber_reaches_a_temperature_and_goes_back_to_ambient(name: str) -> None:
    driver = DRIVERS[name]
    with Player(f"{name}_setpoint") as player:
        chamber = driver.connect(parameters(driver.Parameters, player.address, *RANGE), surroundings())
        seconds = chamber.set_temperature(40 + ZERO_CELSIUS)
        # 15 K (Espec: 13.6 K) at 3 K/min, and the lag of two minutes until the air is within half a kelvin
        assert 15 / 3 * 60 * 0.9 < seconds < 15 / 3 * 60 + 600
        assert chamber.at_temperature()
        chamber.make_safe()
        if name != "espec_p300":
            assert chamber.read() == {"air_degC": 25.0}
        chamber.close()
        player.check()
        assert chamber.remarks() == []
