"""Folder of a blind campaign: what is shown, what is sealed and what was answered.

commitments.txt                        a digest for each case
setups/<plan>-<sensor>/segments.csv    the plan
setups/<plan>-<sensor>/bench.json      what is declared: site, field, noise, resolution, sampling
cases/<case>/recording.parquet         the recording
cases/<case>/case.json                 which set-up it was made with
sealed/<case>.json                     salt and label; nothing but `score` and the oracle reads it
answers/<who>/<case>.json              an answer in the diagnosis' output contract, with the seconds it took
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tests.blind import commitment, generator, real
from tests.blind.device import SENSORS, Sensor
from tests.blind.motion import Array, Schedule, Site
from tests.blind.noise import FREQUENCIES
from tests.blind.plans import PLANS, Segment, read_segments, write_segments


def declared(sensor: Sensor, site: Site) -> dict[str, Any]:
    """What the bench declares; densities are one-sided, `bias_instability` is B of the two-sided density B²/(2πf)."""
    units = {"gyro": "deg/s", "accel": "m/s^2"}
    channels = {
        name: {
            "unit": units[name],
            "white_noise_density": triad.white,
            "bias_instability": triad.instability,
            "flicker_band_hz": [float(FREQUENCIES[0]), float(FREQUENCIES[-1])] if triad.instability else None,
            "resolution": triad.resolution,
        }
        for name, triad in zip(("gyro", "accel"), sensor.triads, strict=False)
    }
    for name, count in zip(generator.channel_names(sensor), sensor.counts, strict=False):
        kind, axis = name.split("_")[:2]
        channels[f"{kind}_{axis}"] = {**channels[kind], "resolution": count}
    return {
        "sensor": sensor.name,
        "sampling_hz": sensor.sampling,
        "encoder": "0 to 360 deg" if sensor.wrapped else "continuous",
        "site": {
            "latitude_deg": site.latitude,
            "gravity_m_per_s2": site.gravity,
            "earth_rate_deg_per_h": site.earth_rate,
            "magnetic_field_enu": list(site.field),
        },
        "channels": channels,
        "columns": ["time_s", "table_angle_deg", "temperature_degC", *generator.channel_names(sensor)],
        "temperature_noise_degC": generator.TEMPERATURE_NOISE,
        "ramp_time_constant_s": 90.0,
        "nominal": "a full 3x3 matrix within some 1e-2 of identity and a constant bias for each triad",
    }


@dataclass(frozen=True)
class Shown:
    """A case as one who diagnoses sees it."""

    name: str
    setup: str
    folder: Path  # of the case
    segments_file: Path
    bench: dict[str, Any]

    @property
    def recording(self) -> Path:
        return self.folder / "recording.parquet"

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        return read_segments(self.segments_file)

    @cached_property
    def columns(self) -> dict[str, Array]:
        import pyarrow.parquet as parquet

        table = parquet.read_table(self.recording)
        return {name: table[name].to_numpy() for name in table.column_names}

    @property
    def sensor(self) -> Sensor:
        return real.sensor_called(self.bench["sensor"])

    @property
    def schedule(self) -> Schedule:
        return Schedule(self.segments, self.sensor.sampling)

    @property
    def plan(self) -> str:
        return self.setup.rsplit("-", 1)[0]

    @property
    def outputs(self) -> Array:
        """Shape (n, channels), °/s and m/s²."""
        return np.column_stack([self.columns[name] for name in generator.channel_names(self.sensor)])


def _write(path: Path, text: str) -> None:
    """Whole or absent, so that a run that was stopped can go on."""
    aside = path.with_name(path.name + ".part")
    aside.write_text(text, encoding="utf-8")
    aside.replace(path)


def write_setups(folder: Path, real_noise: bool = False) -> None:
    for plan, name in real.SETUPS if real_noise else product(PLANS, SENSORS):
        here = folder / "setups" / f"{plan}-{name}"
        here.mkdir(parents=True, exist_ok=True)
        write_segments(here / "segments.csv", PLANS[plan])
        _write(here / "bench.json", json.dumps(declared(real.sensor_called(name), Site()), indent=2) + "\n")


def write_case(folder: Path, case: generator.Case, seed: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    here = folder / "cases" / case.name
    here.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pa.table(case.columns), here / "recording.parquet", compression="zstd")
    (folder / "sealed").mkdir(exist_ok=True)
    secret = commitment.salt(seed, case.name)
    _write(folder / "sealed" / f"{case.name}.json", json.dumps({"salt": secret, "label": case.label}, indent=1) + "\n")
    _write(here / "case.json", json.dumps({"case": case.name, "setup": f"{case.plan}-{case.sensor}"}) + "\n")


def shown(folder: Path, name: str) -> Shown:
    here = folder / "cases" / name
    setup = json.loads((here / "case.json").read_text(encoding="utf-8"))["setup"]
    table = folder / "setups" / setup
    bench = json.loads((table / "bench.json").read_text(encoding="utf-8"))
    return Shown(name, setup, here, table / "segments.csv", bench)


def made(folder: Path) -> list[str]:
    """Names of the cases that are whole."""
    return sorted(path.parent.name for path in (folder / "cases").glob("*/case.json"))


def sealed(folder: Path) -> dict[str, dict]:
    return {p.stem: json.loads(p.read_text(encoding="utf-8")) for p in sorted((folder / "sealed").glob("*.json"))}


def commit(folder: Path) -> None:
    """Writes `commitments.txt` over all cases."""
    labels = sealed(folder)
    digests = {case: commitment.commitment(one["salt"], one["label"]) for case, one in labels.items()}
    _write(folder / "commitments.txt", commitment.written(digests))


def verified_labels(folder: Path) -> dict[str, dict]:
    """Labels by case, checked against `commitments.txt`; raises BrokenSealError."""
    labels = sealed(folder)
    commitment.verify(commitment.read((folder / "commitments.txt").read_text(encoding="utf-8")), labels)
    return {case: one["label"] for case, one in labels.items()}


def answer_file(folder: Path, who: str, case: str) -> Path:
    return folder / "answers" / who / f"{case}.json"


def write_answer(folder: Path, who: str, case: str, answer: dict) -> None:
    path = answer_file(folder, who, case)
    path.parent.mkdir(parents=True, exist_ok=True)
    _write(path, json.dumps(answer) + "\n")


def answers(folder: Path, who: str) -> dict[str, dict]:
    found = sorted((folder / "answers" / who).glob("*.json"))
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in found}
