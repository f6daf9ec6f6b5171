"""What a run is told must read as it is: no character that hides, or turns the reading order."""

from __future__ import annotations

from pathlib import Path

import pytest

from planrunner.base.findings import InputError
from planrunner.plan.run_information import gather_for_issue


@pytest.mark.parametrize("char", ["\u202e", "\u2066", "\u200b", "\u200f", "\x9b", "\x1b"])
def test_a_serial_number_with_a_hidden_character_is_refused(char: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        gather_for_issue(["device_serial"], [f"device_serial=SN-{char}7"], None)
    assert caught.value.findings[0].code == "run-info-value"
    info = tmp_path / "info.yaml"
    info.write_text(f"device_serial: SN-{char}7\n", encoding="utf-8")
    with pytest.raises(InputError):
        gather_for_issue(["device_serial"], [], info)


def test_letters_of_every_language_are_taken() -> None:
    given = {"operator": "Łukasz Müller 李 محمد", "device_serial": "SN-7"}
    assert gather_for_issue(list(given), [f"{name}={value}" for name, value in given.items()], None) == given
