"""Plain names, actors and remedies of the effects, and the page that lists them."""

from __future__ import annotations

from pathlib import Path
from string import Formatter

import pytest

from planrunner.base import plugins
from planrunner.error_model.effects.gyro_output import GyroBandwidth
from planrunner.error_model.effects.interface import Actor, TellsAbout, Variant, about
from planrunner.error_model.observed import Observed
from planrunner.error_model.reference import reference

OWN = plugins.names(plugins.EFFECTS)


@pytest.mark.parametrize("name", OWN)
def test_every_shipped_effect_says_who_acts_and_what_to_do(name: str) -> None:
    effect = plugins.load(plugins.EFFECTS, name)()
    assert isinstance(effect, TellsAbout)
    told = effect.about
    assert told.name != name
    assert told.physics.endswith(".") and told.physics.count(". ") == 0
    fields = {field for _, field, _, _ in Formatter().parse(told.remedy) if field}
    derived = {} if told.figures is None else told.figures(0.01)
    assert fields - set(derived) == {"found"}
    assert set(derived) <= fields


def test_names_are_distinct() -> None:
    names = [about(plugins.load(plugins.EFFECTS, name)()).name for name in OWN]
    assert len(set(names)) == len(names)


def test_a_lag_gives_the_bandwidth_and_the_frequency_at_which_it_is_one_degree() -> None:
    """A lag of 15.9155 ms has a bandwidth of 10 Hz; its phase at f is atan(f ÷ 10 Hz), one degree at 0.17455 Hz."""
    words = GyroBandwidth.about.advice("tau 15.9 ms", 0.0159155)
    assert "10 Hz" in words and "0.17 Hz" in words and "tau 15.9 ms" in words


def test_a_plug_in_without_words_has_sensible_ones() -> None:
    class ThirdParty:
        """Output follows the supply
        voltage.

        More follows here."""

        id, stage = "supply_sensitivity", "sensor"

        def variants(self, observed: Observed) -> list[Variant]:
            return []

    told = about(ThirdParty())
    assert (told.name, told.physics, told.actor) == (
        "supply sensitivity",
        "Output follows the supply voltage.",
        Actor.SENSOR,
    )
    assert "k 3 V" in told.advice("k 3 V", None)


def test_the_page_of_effects_is_up_to_date() -> None:
    page = (Path(__file__).parents[2] / "docs/effects.md").read_text(encoding="utf-8")
    assert page == reference(), "run `python -m planrunner.error_model.reference docs`"
