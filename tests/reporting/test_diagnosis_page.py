"""The diagnosis in sentences, tables and on its page; the schema of its JSON."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from diagnosis_example import CHANNELS, EFFECTS, SEGMENTS, diagnosis
from jsonschema import Draft202012Validator, ValidationError

from planrunner.reporting import terminal
from planrunner.reporting.diagnosis_page import (
    DiagnosisContext,
    closure_words,
    probability,
    ranked,
    render_page,
    tables,
    verdict,
)

SCHEMA = json.loads((Path(__file__).parents[2] / "schemas" / "diagnosis.schema.json").read_text(encoding="utf-8"))
KINDS = ("none", "effect", "pair", "unknown", "indistinguishable")


def check(found):
    Draft202012Validator(SCHEMA).validate(json.loads(json.dumps(found, allow_nan=False)))


@pytest.mark.parametrize("kind", KINDS)
def test_the_example_fits_the_schema(kind):
    Draft202012Validator.check_schema(SCHEMA)
    check(diagnosis(kind))
    check(diagnosis(kind, next=None))


@pytest.mark.parametrize(
    "changes",
    [
        {"planrunner_diagnosis": 2},
        {"posterior": {"none": 1.2, "unknown": 0.0}},
        {"posterior": {"none": 1.0}},
        {"posterior": {"none": 0.5, "unknown": 0.5, "a b": 0.0}},
        {"verdict": {"kind": "perhaps", "effects": [], "class": []}},
        {"closure": {"before": 1.0, "after": 1.0, "shrinks_by": 0.0, "interval_90": [0.0], "resolvable": True}},
        {"absorbed": [{"effect": "lever_arm"}]},
    ],
)
def test_the_schema_refuses_what_is_not_a_diagnosis(changes):
    with pytest.raises(ValidationError):
        check(diagnosis(**changes))


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("none", "No gap: noise alone explains the recording (P = 0.97)."),
        ("effect", "gyro_g_sensitivity explains the gap (P = 0.96)."),
        ("pair", "gyro_g_sensitivity and lever_arm together explain the gap (P = 0.02)."),
        ("unknown", "A gap caused by something that the catalogue does not contain (P = 0.97)."),
        (
            "indistinguishable",
            "gyro_g_sensitivity or table_tilt explains the gap: this plan cannot distinguish them (together P = 0.97).",
        ),
    ],
)
def test_the_verdict_in_one_sentence(kind, words):
    assert verdict(diagnosis(kind)) == words


def test_noise_far_from_its_declaration_is_said_beside_the_verdict():
    first = {
        "unit": "deg/s",
        "count": 0.0,
        "declared_count": 0.0,
        "slow": 1.0,
        "quietest": 1.0,
        "loudest": 1.0,
        "line": None,
    }
    loud = [{**first, "channel": name, "declared": 1.0, "white": white} for name, white in (("a", 3.0), ("b", 2.9))]
    quiet = {**first, "channel": "c", "declared": 1.0, "white": 0.02}
    right = {**first, "channel": "d", "declared": 1.0, "white": 1.9}
    found = diagnosis("none", noise=[*loud, quiet, right])
    check(found)
    assert verdict(found) == (
        "No gap: noise alone explains the recording (P = 0.97). The noise of a and b is larger than declared by a "
        "factor of 2.9 to 3. The noise of c is smaller than declared by a factor of 50."
    )


def test_noise_alone_is_not_said_to_be_sure_where_it_is_only_possible():
    found = diagnosis("none", posterior={"none": 0.4, "unknown": 0.1, "lever_arm": 0.5})
    assert verdict(found) == "No effect is named: noise alone may explain the recording (P = 0.40)."


def test_noise_alone_includes_noise_that_is_not_as_declared():
    found = diagnosis(
        "none",
        posterior={"none": 0.15, "unknown": 0.06, "gyro_noise_excess": 0.77, "gyro_noise_excess+lever_arm": 0.02},
        noise_effects={"gyro_noise_excess": 0.79},
    )
    check(found)
    assert verdict(found) == "No effect is named: noise alone may explain the recording (P = 0.92)."


def test_an_effect_of_its_form_is_named_beside_it():
    found = diagnosis(verdict={"kind": "effect", "effects": ["lever_arm"], "class": [], "form_residue": "time_latency"})
    check(found)
    assert (
        "The contribution of time_latency is below 5 % and is treated as an error of the modelled form (form residue)."
        in verdict(found)
    )


def test_the_weaker_of_two_is_said_to_be_form_residue_perhaps():
    said = {"kind": "pair", "effects": ["lever_arm", "time_latency"], "class": [], "form_residue": "time_latency"}
    found = diagnosis(verdict=said, posterior={"none": 0.0, "lever_arm+time_latency": 0.98, "unknown": 0.02})
    check(found)
    assert verdict(found) == (
        "lever_arm and time_latency together explain the gap (P = 0.98). time_latency explains less than 5 % of the gap: either "
        "it is present but weak, or it only makes up for an error in the modelled form of lever_arm (form residue)."
    )


def test_a_remainder_beside_what_the_nominal_model_lacks_is_said_to_be():
    said = {"kind": "pair", "effects": ["gyro_bias", "gyro_scale_factor"], "class": [], "form_residue": "unknown"}
    found = diagnosis(verdict=said, posterior={"none": 0.0, "unknown": 1.0})
    check(found)
    rest = " The rest comes from something that the catalogue does not contain."
    assert verdict(found) == "gyro_bias and gyro_scale_factor together explain nearly all of the gap." + rest
    found["verdict"] = said | {
        "kind": "indistinguishable",
        "class": ["gyro_bias+gyro_scale_factor", "gyro_bias+table_rate_error"],
    }
    check(found)
    members = "gyro_bias+gyro_scale_factor or gyro_bias+table_rate_error"
    assert verdict(found) == f"{members} explains nearly all of the gap: this plan cannot distinguish them." + rest


def test_what_takes_up_the_form_beside_an_effect_counts_for_it():
    said = {"kind": "effect", "effects": ["lever_arm"], "class": [], "form_residue": "time_latency"}
    found = diagnosis(
        verdict=said, posterior={"none": 0.0, "lever_arm+time_latency": 0.98, "lever_arm": 0.01, "unknown": 0.01}
    )
    assert verdict(found).startswith("lever_arm explains the gap (P = 0.99).")


def test_a_hundred_parameters_are_not_all_shown():
    one = {"effect": "table_position_error", "name": "x", "value": 1.0, "unit": "arcsec", "standard_uncertainty": 1.0}
    rows = tables(diagnosis(parameters=[one] * 111))["parameters"].rows
    assert len(rows) == 25 and rows[-1][0] == "and 87 more, in the diagnosis as JSON"


def test_the_closure_with_its_interval_or_not_resolvable():
    assert closure_words(diagnosis()) == (
        "The gap of withheld segments shrinks by 96 % (90 % interval 94 % to 98 %), from 5.21 to 0.21 standard deviations of the noise."
    )
    for low, middle, high, text in (
        (-0.30, -0.21, -0.12, "grows by 21 % (90 % interval 12 % to 30 %)"),
        (-0.03, 0.05, 0.12, "shrinks by 5 % (90 % interval it grows by 3 % to it shrinks by 12 %)"),
        (-0.2, -0.0004, 0.2, "grows by < 0.1 % (90 % interval it grows by 20 % to it shrinks by 20 %)"),
    ):
        made = {"before": 1.0, "after": 1.2, "shrinks_by": middle, "interval_90": [low, high], "resolvable": True}
        said = closure_words(diagnosis(closure=made))
        assert text in said
        assert "-" not in said
    cannot = {"before": None, "after": None, "shrinks_by": None, "interval_90": None, "resolvable": False}
    assert "cannot show by how much" in closure_words(diagnosis(closure=cannot))
    repeat = closure_words(diagnosis(closure={**cannot, "reason": "not repeated"}))
    assert repeat.endswith("Repeat the segments that show the effect.")
    again = {"shrinks_by": 0.97, "interval_90": [0.92, 0.98]}
    repeated = closure_words(diagnosis(closure={**cannot, "reason": "not repeated", "repetition": again}))
    assert repeated.startswith(repeat)
    assert "In a repetition of the same segments, the gap shrinks by 97 % (90 % interval 92 % to 98 %)" in repeated
    walk = {"unpredicted": ["gyro_bias_random_walk"]}
    alone = closure_words(diagnosis(closure={**cannot, **walk, "reason": "random"}))
    assert alone.startswith("gyro_bias_random_walk cannot be predicted from other segments, because it is random.")
    beside = closure_words(diagnosis(closure={**made, **walk, "reason": None}))
    assert "The gap that remains includes gyro_bias_random_walk" in beside
    assert closure_words(diagnosis("none")) == "There is no gap to close."


@pytest.mark.parametrize(
    ("p", "words"), [(0.99996, "P > 0.999"), (0.9954, "P = 0.995"), (0.5, "P = 0.50"), (0.0, "P < 0.001")]
)
def test_a_probability_is_never_a_certainty(p, words):
    assert probability(p) == words


def test_hypotheses_are_ranked_and_the_rest_summed_up():
    names = [name for name, _ in ranked(diagnosis())]
    assert names == ["gyro_g_sensitivity", "gyro_g_sensitivity+lever_arm", "table_tilt", "others"]
    assert sum(p for _, p in ranked(diagnosis())) == pytest.approx(1.0)


def test_only_places_that_noise_does_not_explain_are_shown():
    found = diagnosis()
    assert [row[0] for row in tables(found)["where"].rows] == ["gyro_z"]
    for place in found["where"]:
        place["p"] = 0.4
    assert "where" not in tables(found)


def test_tables_in_the_terminal_hold_every_answer(capsys):
    console = terminal.console(width=120)
    for table in tables(diagnosis()).values():
        console.print(terminal.data_table(table))
    shown = capsys.readouterr().out
    for text in ("gyro_z", "x up, y north, z west", "61 %", "0.961", "table_rate_error", "0.00412", "deg/s/g"):
        assert text in shown


class Words(HTMLParser):
    """Text of a page, and the addresses that it would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.text: list[str] = []
        self.ids: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag, attrs):
        for name, value in attrs:
            if name == "id":
                self.ids.append(value)
            if name in ("src", "href", "xlink:href") and not value.startswith("#"):
                self.fetched.append(value)

    def handle_data(self, data):
        self.text.append(data)


def page(found, **changes):
    html = render_page(DiagnosisContext("A plan", found, {"Recording": "r.parquet"}, **changes))
    words = Words()
    words.feed(html)
    return html, words


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_is_whole_and_fetches_nothing(kind):
    html, words = page(diagnosis(kind), remarks=("3 rows are left out: look",), next_plan="planrunner: 1\n")
    assert words.fetched == []
    assert not re.search(r"url\(\s*['\"]?(?!#)", html)
    assert len(words.ids) == len(set(words.ids))
    text = " ".join(words.text)
    for shown in (
        verdict(diagnosis(kind)),
        closure_words(diagnosis(kind)),
        "3 rows are left out",
        "planrunner: 1",
        "Priors: none 0.20, single 0.50,",
    ):
        assert shown in text
    for name in (*CHANNELS[:3], *EFFECTS, SEGMENTS[0], "ramp-20"):
        assert name in text


def test_a_diagnosis_without_pictures_or_proposal_has_a_page_as_well():
    found = diagnosis("none", next=None)
    del found["pictures"]
    _, words = page(found)
    assert "Nothing is proposed." in " ".join(words.text)


def test_text_from_files_cannot_become_markup():
    found = diagnosis()
    found["where"][0]["level"] = "<script>alert(1)</script>"
    html, _ = page(found, next_plan="</pre><script>x</script>")
    assert "<script>" not in html


def test_something_else_is_said_with_its_size() -> None:
    """Whatever is visible beside the named effects: they do not explain the gap."""
    found = diagnosis("pair")
    found["verdict"]["something_else"] = True
    channels = {"gyro_x": 1.9, "gyro_y": 1.0}
    found["rest"] = {
        "share": 0.2,
        "times_noise": channels,
        "sigma": {"gyro_x": 35.2, "gyro_y": 0.0},
        "p": 0.0,
        "passes": False,
    }
    said = verdict(found)
    assert said.startswith("gyro_g_sensitivity, lever_arm and something else of 35 σ on gyro_x cause the gap")
    assert "explain" not in said.split(".")[0]
