"""Plug-ins by name: the project's own keep their names, and finding them reads no other distribution."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import EntryPoint, EntryPoints, distribution

import pytest

from planrunner.base import plugins
from planrunner.base.findings import InputError
from planrunner.error_model.effects.interface import OutsideCoefficients, Variant, effect_named
from planrunner.error_model.observed import Observed
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic

OWN = "flexure_gyro_static"
FROM_ELSEWHERE = EntryPoints(
    [
        EntryPoint(OWN, "json:loads", plugins.ESTIMATORS),
        EntryPoint("of_another_house", "planrunner.estimators.scale_factor:ScaleFactor", plugins.ESTIMATORS),
        EntryPoint("unfinished", "json:JSONDecoder", plugins.ESTIMATORS),
        EntryPoint("broken", "no_such_module:Estimator", plugins.ESTIMATORS),
        EntryPoint("noise_of_old", "tests.base.test_plugins:NoiseOfOld", plugins.EFFECTS),
        EntryPoint("noise_of_today", "tests.base.test_plugins:NoiseOfToday", plugins.EFFECTS),
    ]
)


class NoiseOfOld:
    """An effect on the noise as development versions had it: it does not state what it changes."""

    id, stage, noise = "noise_of_old", "covariance", "white"

    def variants(self, observed: Observed) -> list[Variant]:
        return []


class NoiseOfToday(NoiseOfOld):
    id, outside = "noise_of_today", "white"


@pytest.fixture(autouse=True)
def _anew() -> Iterator[None]:
    tables = (plugins._table, plugins.load)
    for table in tables:
        table.cache_clear()
    yield
    for table in tables:
        table.cache_clear()


def test_another_distribution_cannot_take_a_name_of_the_project(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_installed", lambda: FROM_ELSEWHERE)
    assert plugins.load(plugins.ESTIMATORS, OWN) is FlexureGyroStatic
    assert {OWN, "of_another_house"} <= set(plugins.names(plugins.ESTIMATORS))
    assert list(plugins.names(plugins.ESTIMATORS)) == sorted(plugins.names(plugins.ESTIMATORS))
    assert callable(plugins.load(plugins.ESTIMATORS, "of_another_house"))


def test_an_effect_on_the_noise_that_does_not_state_its_kind_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_installed", lambda: FROM_ELSEWHERE)
    with pytest.raises(InputError) as refused:
        effect_named("noise_of_old")
    (finding,) = refused.value.findings
    assert finding.code == "plugin-broken"
    assert "'noise_of_old' has the stage covariance, but no attribute 'outside'" in finding.message
    assert isinstance(effect_named("noise_of_today"), OutsideCoefficients)


def test_a_plug_in_of_the_project_is_found_without_reading_other_distributions(monkeypatch: pytest.MonkeyPatch) -> None:
    def read_all() -> EntryPoints:
        raise AssertionError("every installed distribution was read")

    monkeypatch.setattr(plugins, "_installed", read_all)
    assert plugins.load(plugins.ESTIMATORS, OWN) is FlexureGyroStatic


@pytest.mark.parametrize(
    ("name", "code"), [("unheard_of", "plugin-unknown"), ("broken", "plugin-broken"), ("unfinished", "plugin-broken")]
)
def test_what_cannot_be_loaded_is_a_finding(name: str, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_installed", lambda: FROM_ELSEWHERE)
    with pytest.raises(InputError) as raised:
        plugins.load(plugins.ESTIMATORS, name)
    assert [finding.code for finding in raised.value.findings] == [code]


def test_the_projects_entry_points_are_those_of_its_installation() -> None:
    listed = distribution("planrunner").entry_points
    assert set(plugins._entries()) == {(entry.group, entry.name, entry.value) for entry in listed}


def test_a_list_of_entry_points_may_have_comments_and_blank_lines() -> None:
    lines = [
        "# made by a tool\n",
        "\n",
        "[planrunner.effects]\n",
        "one = a.b:C.d\n",
        "; two = x:y\n",
        "[other]\n",
        "three=m:n\n",
    ]
    assert list(plugins._read(lines)) == [("planrunner.effects", "one", "a.b:C.d"), ("other", "three", "m:n")]
