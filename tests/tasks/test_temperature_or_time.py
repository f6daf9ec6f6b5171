"""A temperature that changes in proportion to time: a diagnosis says that a drift of the bias would look the same."""

from __future__ import annotations

from pathlib import Path

from planrunner.tasks.diagnose import diagnose_recorded, recorded_file

PLANS = Path(__file__).parents[2] / "plans"
FILE = "TVCtest3_7_20.csv"


def _warnings(recording: Path) -> tuple[tuple[str, ...], list[str]]:
    """What the verdict names, and the messages of the warnings about temperature and time."""
    made = diagnose_recorded(recorded_file(PLANS / "psim_gyro_thermal_vacuum.yaml", None, recording))
    said = [one.message for one in made.findings if one.code == "gap-temperature-or-time"]
    return made.diagnosis.verdict.effects, said


def test_a_chamber_that_only_cooled_cannot_exclude_a_drift(data_root: Path) -> None:
    """By hand: 23.82 to 15.66 degC from 18 to 7337 s, −4.0 K/h between the ends; the middle is a little steeper."""
    named, said = _warnings(data_root / "psim_thermal_vacuum" / FILE)
    assert named == ("gyro_bias_temperature",)
    (message,) = said
    assert "-4." in message and "K/h" in message and "gyro_bias_temperature from a steady drift of the bias" in message


def test_a_temperature_that_returns_gives_no_warning(data_root: Path, tmp_path: Path) -> None:
    """The same bursts, in an order in which the chamber cools and warms again: every second burst is played backwards at the end."""
    header, *rows = (data_root / "psim_thermal_vacuum" / FILE).read_text(encoding="utf-8").splitlines()
    times = [row.split(",", 1)[0] for row in rows]
    bursts = [[row.split(",", 1)[1] for row in rows[n : n + 250]] for n in range(0, len(rows), 250)]
    again = [row for burst in bursts[::2] + bursts[1::2][::-1] for row in burst]
    text = "\n".join([header, *(f"{time},{rest}" for time, rest in zip(times, again, strict=True))]) + "\n"
    (tmp_path / FILE).write_text(text, encoding="utf-8")
    named, said = _warnings(tmp_path / FILE)
    assert "gyro_bias_temperature" in named
    assert said == []
