"""Plans that hypothesis writes for the virtual benches: every motion, orientation, temperature, rate, sampling and dwell, and estimates.

Most plans are tame: what they ask is near what the bench gives. The others ask for anything, so that `check` has much to refuse. Dwells are
short: a plan takes milliseconds to carry out on a virtual clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import accumulate, permutations
from typing import Any

from hypothesis import strategies as st

from planrunner.bench.model import BenchModels, models, read_bench, shipped_benches
from planrunner.instruments.models import SensorModel
from planrunner.physics.kinematics import TableAxis
from tests.directions import WORDS

Plan = dict[str, Any]
VIRTUAL = sorted(name for name in shipped_benches() if name.startswith("virtual"))
COMPASS = ("up", "down", "north", "south", "east", "west")


@cache
def known(bench: str) -> BenchModels:
    return models(read_bench(bench)[0])


def _right_handed() -> list[dict[str, str]]:
    """The 24 orientations in words."""
    names = {vector: name for name, vector in WORDS.items()}
    found = []
    for x, y in permutations(COMPASS, 2):
        (a, b, c), (d, e, f) = WORDS[x], WORDS[y]
        if a * d + b * e + c * f == 0:
            z = (b * f - c * e, c * d - a * f, a * e - b * d)
            found.append({"x": x, "y": y, "z": names[z]})
    return found


CARDINAL = _right_handed()
UPRIGHT = {"x": "east", "y": "north", "z": "up"}


@cache
def amount(unit: str, *values: float) -> st.SearchStrategy[str]:
    return st.sampled_from(values).map(lambda value: f"{value:g} {unit}")


@cache
def between(unit: str, low: float, high: float, digits: int = 3) -> st.SearchStrategy[str]:
    """A quantity drawn evenly over the decades between two, or over a thousand steps where they have two signs."""
    if low > 0:
        drawn = st.floats(math.log(low), math.log(high)).map(math.exp)
    else:
        drawn = st.integers(0, 1000).map(lambda step: low + (high - low) * step / 1000)
    return drawn.map(lambda value: f"{value:.{digits}g} {unit}")


@dataclass(frozen=True)
class Draft:
    """What a plan is drawn for. wild: whether some of its choices ask for anything."""

    bench: str
    wild: bool

    @property
    def sensor(self) -> SensorModel:
        sensor = known(self.bench).sensor
        assert sensor is not None
        return sensor

    @property
    def axes(self) -> tuple[TableAxis, ...]:
        table = known(self.bench).table
        return () if table is None else table.axes

    @property
    def flat(self) -> bool:
        """Whether the sensor's z axis has to stay up."""
        return len(self.axes) < 2

    @property
    def limited(self) -> bool:
        return not self.axes[0].continuous

    def odd(self, draw: st.DrawFn) -> bool:
        """Whether the next choice asks for anything."""
        return self.wild and draw(st.integers(0, 3)) == 0


@st.composite
def orientations(draw: st.DrawFn, draft: Draft) -> Any:
    flat = draft.flat and not draft.odd(draw)
    kind = draw(st.sampled_from(["words", "words", "turned", "unknown"]))
    if kind == "unknown":
        return "unknown"
    if kind == "words":
        return draw(st.sampled_from([one for one in CARDINAL if one["z"] == "up" or not flat]))
    turn = st.tuples(st.sampled_from("z" if flat else "xyz"), between("deg", -180, 180)).map(" ".join)
    first = UPRIGHT if flat else draw(st.sampled_from(CARDINAL))
    return {"from": first, "rotate": draw(st.lists(turn, min_size=1, max_size=2))}


@st.composite
def cycles(draw: st.DrawFn, draft: Draft) -> dict[str, Any]:
    """A cycle that closes, unless it is odd."""
    odd = draft.odd(draw)
    turns = draw(
        st.lists(st.sampled_from([-180, -90, -45, -1, 1, 45, 90, 180]), min_size=1, max_size=2 if draft.limited else 4)
    )
    if not odd:
        turns = [*turns, *(-turn for turn in reversed(turns))]
    angles = [round(angle % 360, 6) % 360 for angle in accumulate(turns, initial=0)]
    names: dict[float, str] = {}
    for angle in angles:
        names.setdefault(angle, f"P{len(names)}")
    return {
        "cycle": {name: f"{angle:g} deg" for angle, name in names.items()},
        "moves": [f"{names[a]} {turn:+d} {names[b]}" for a, turn, b in zip(angles, turns, angles[1:], strict=False)],
        "turn_rate": draw(between("deg/s", 5, 500 if odd else math.degrees(draft.axes[0].max_rate))),
        "stop": draw(st.one_of(st.just("0 s"), between("s", 0.01, 1))),
    }


@st.composite
def rockings(draw: st.DrawFn, draft: Draft, dwell: float) -> dict[str, Any]:
    odd = draft.odd(draw)
    rings = draw(st.integers(1, 3 if odd else len(draft.axes)))
    frequency = draw(
        st.one_of(st.sampled_from([1.0, 10.0, 25.0, 50.0, 100.0]), st.floats(0.5, 60).map(lambda f: float(f"{f:.3g}")))
    )
    circular = 2 * math.pi * frequency
    most = min(min(axis.max_rate / circular, axis.max_acceleration / circular**2) for axis in draft.axes[:rings])
    share = draw(st.sampled_from([0.01, 0.5, 0.999])) * (50 if odd else 1)
    amplitude = math.degrees(min(most, 6.0) * share)
    rock: dict[str, Any] = {"amplitude": f"{amplitude:.6g} deg", "frequency": f"{frequency:g} Hz"}
    if rings > 1 or draw(st.booleans()):
        rock["phases"] = draw(st.lists(amount("deg", 0, 45, 90, -90), min_size=rings, max_size=rings))
    lasts = draw(st.sampled_from([None, None, dwell, dwell / 3, 5.0 if odd else None]))
    motion = {"rock": rock, **({} if lasts is None else {"for": f"{lasts:.6g} s"})}
    if draw(st.integers(0, 4)) == 0:
        motion["after"] = f"{dwell / draw(st.sampled_from([2, 3, 10])):.6g} s"
    return motion


@st.composite
def motions(draw: st.DrawFn, draft: Draft, dwell: float) -> dict[str, Any]:
    """What a state says of motion; may be nothing. dwell: s."""
    kind = draw(st.sampled_from(["rest", "rest", "rest", "rate", "rate", "about", "rock", "rock", "cycle"]))
    if kind == "rest" or not draft.axes:
        return draw(st.sampled_from([{}, {}, {"motion": "rest"}]))
    outer = draft.axes[0]
    fastest = math.degrees(outer.max_rate)
    odd = draft.odd(draw)
    if not odd and draft.limited:  # the cables let it go a turn from the middle, spin-up and settling included
        fastest = min(fastest, 8.0)
    rates = st.one_of(
        st.sampled_from([0, 1, -1, 5, -5, fastest, -fastest, 1.2 * fastest if odd else 2]).map(
            lambda rate: f"{rate:g} deg/s"
        ),
        between("deg/s", -fastest, fastest),
    )
    if kind == "rate":
        return {"rate": draw(rates)}
    if kind == "about":
        about = draw(
            st.sampled_from(COMPASS if odd or (not draft.flat and draw(st.integers(0, 2)) == 0) else COMPASS[:2])
        )
        fraction = draw(between("deg/s", -100, 100)) if about not in COMPASS[:2] else draw(rates)
        return {
            "motion": {
                "rate": fraction,
                "about": about,
                "sense": draw(st.sampled_from(["clockwise", "counterclockwise"])),
            }
        }
    return {"motion": draw(rockings(draft, dwell) if kind == "rock" else cycles(draft))}


@st.composite
def temperatures(draw: st.DrawFn, draft: Draft) -> dict[str, Any]:
    if not known(draft.bench).chamber and not draft.odd(draw):
        return {}
    kind = draw(st.sampled_from(["none", "none", "hold", "hold", "ramp"]))
    if kind == "none":
        return {}
    value = draw(
        amount("degC", -60, 100)
        if draft.odd(draw)
        else st.one_of(amount("degC", -55, 20, 25, 60, 85), between("degC", 0, 50))
    )
    if kind == "hold":
        soak = draw(st.sampled_from([None, "0 s", "20 min", "2 h"]))
        return {"temperature": value, **({} if soak is None else {"soak": soak})}
    lasting = {} if draft.odd(draw) else {"dwell": "60 min", "sample_rate": "1 Hz", "motion": "rest"}
    return {"temperature": {"ramp_to": value}, **lasting}


@st.composite
def states(draw: st.DrawFn, draft: Draft) -> dict[str, Any]:
    """One state; what it does not say comes from the defaults."""
    seconds = float(f"{draw(st.one_of(st.floats(0.03, 3), st.sampled_from([1.0, 2.0]))):.3g}")
    if draft.odd(draw):
        seconds = draw(st.sampled_from([0.001, 0.005, 0.012]))
    motion = draw(motions(draft, seconds))
    state: dict[str, Any] = dict(motion)
    if draw(st.booleans()):
        state["orientation"] = draw(orientations(draft))
    moving = motion.get("motion")
    spin = abs(float(motion.get("rate", "0 deg/s").split()[0]))
    if isinstance(moving, dict) and "cycle" in moving and draw(st.booleans()):
        state["dwell"] = {"cycles": 1}
    elif spin > 50 and draw(st.booleans()):
        state["dwell"] = {"turns": draw(st.integers(1, 2))}
    elif draft.odd(draw):
        state["dwell"] = "recorded"
    elif draw(st.integers(0, 3)) or isinstance(moving, dict):
        state["dwell"] = f"{seconds:g} s"
    if draw(st.integers(0, 3)) == 0:
        own, odd = draft.sensor.sample_rate, draft.odd(draw)
        state["sample_rate"] = f"{draw(st.sampled_from([1.0, 2 * own] if odd else [own, own / 1.5])):g} Hz"
    if draw(st.integers(0, 3)) == 0:
        state["settle"] = draw(st.sampled_from(["0 s", "0.5 s", "30 s" if draft.odd(draw) else "2 s"]))
    if draft.sensor.modes and draw(st.integers(0, 3)) == 0:
        state["mode"] = "idle" if draft.odd(draw) else draw(st.sampled_from(draft.sensor.modes))
    if draw(st.integers(0, 9)) == 0:
        state["on_break"] = draw(st.sampled_from(["keep", "retake"]))
    warm = draw(temperatures(draft))
    if "dwell" in warm:
        state.pop("rate", None)
    return {**state, **warm}


@st.composite
def segments(draw: st.DrawFn, draft: Draft, label: str, depth: int = 0) -> dict[str, Any]:
    """An entry of `segments`: a state, a sweep over states, or steps that share one."""
    entry: dict[str, Any] = {"label": label, **draw(states(draft))}
    form = draw(st.sampled_from(["one", "one", "one", "sweep", "repeat", "steps" if depth == 0 else "one"]))
    if form == "sweep":
        swept = draw(
            st.sampled_from(["rate", "orientation", "dwell", *(["temperature"] if known(draft.bench).chamber else [])])
        )
        entry.pop(swept, None)
        if isinstance(entry.get("dwell"), dict):
            entry.pop("dwell")
        if swept == "rate":
            entry.pop("motion", None)
            fast = (
                ["±1, ±2 deg/s", "5, 4, 3 deg/s"]
                if draft.limited
                else ["±10, ±20 deg/s", "±50, ±30, 0 deg/s", "1, 2, 3 deg/s"]
            )
            values: Any = draw(st.sampled_from(fast))
        elif swept == "orientation":
            drawn = draw(st.lists(orientations(draft), min_size=2, max_size=8))
            values = {f"O{number}": one for number, one in enumerate(drawn)}
        elif swept == "temperature":
            values = draw(st.sampled_from([["-20 degC", "20 degC", "50 degC"], ["25 degC", "30 degC"]]))
        else:
            values = ["0.5 s", "1 s", "2 s"]
            entry.pop("temperature", None)
            if isinstance(entry.get("motion"), dict):
                entry["motion"].pop("for", None)
        entry["for_each"] = {swept: values}
        entry["order"] = draw(st.sampled_from(["as_written", "reversed", "serpentine", "shuffled"]))
    elif form == "repeat":
        entry["repeat"] = draw(st.integers(1, 4))
    elif form == "steps":
        count = draw(st.integers(1, 3))
        entry["steps"] = [draw(segments(draft, f"{label}{number}", depth + 1)) for number in range(count)]
    return entry


def _six_or_more(count: int) -> dict[str, Any]:
    """Orientations from which a triad can be calibrated."""
    chosen = [CARDINAL[(7 * number) % len(CARDINAL)] for number in range(count)]
    return {f"O{number}": one for number, one in enumerate(chosen)}


@st.composite
def estimable(draw: st.DrawFn, draft: Draft) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Segments in the pattern of a known method, and the estimate that it is for: where one is sensible at all."""
    sensor, three = draft.sensor, len(draft.axes) == 3
    names = [output.name for output in sensor.outputs]
    gyros = [name for name in names if name.startswith("gyro_")]
    accels = [name for name in names if name.startswith("accel_")]
    rated = gyros or [name for name in names if name.startswith("torquer")]
    dwell = draw(between("s", 0.03, 3))
    basis = draw(st.sampled_from([{}, {}, {"uncertainty": "within_segment"}, {"uncertainty": "residual"}]))
    forms = ["allan", "still", "temperature", "repeat"]
    forms += ["rates", "rates"] if draft.axes and rated else []
    forms += ["flexure"] if sensor.kind == "flexure-gyro" else []
    forms += ["tilted"] if sensor.kind == "gyro-triad" else []
    forms += ["triad", "triad"] if len(accels) == 3 and three else []
    forms += ["navigate"] if len(gyros) == 3 and len(accels) == 3 else []
    forms += ["rocking"] if sensor.kind == "stabilised-platform" else []
    form = draw(st.sampled_from(forms))
    state: dict[str, Any] = {"orientation": UPRIGHT, "dwell": dwell}
    if form == "rates":
        orientation = draw(st.sampled_from(CARDINAL)) if three else UPRIGHT
        chosen = draw(st.lists(st.sampled_from(rated), min_size=1, max_size=3, unique=True))
        swept = draw(
            st.sampled_from(
                ["±10, ±20 deg/s", "±100, ±50, 0 deg/s", "1, 2 deg/s", "10, 20, 40 deg/s", "±500, ±20 deg/s"]
            )
        )
        entry = {**state, "orientation": orientation, "label": "R", "for_each": {"rate": swept}}
        return [entry], {"estimator": "scale_factor", "segments": "R", "outputs": chosen, **basis}
    if form == "flexure":
        count = draw(st.sampled_from([4, 8, 12, 24]))
        entry = {**state, "label": "P", "for_each": {"orientation": _six_or_more(count)}}
        entry.pop("orientation")
        return [entry], {"estimator": "flexure_gyro_static", "segments": "P", **basis}
    if form == "tilted":
        entry = {
            "label": "series",
            "orientation": UPRIGHT,
            "dwell": dwell,
            "steps": [
                {"label": "start-zero"},
                {"label": "spin", "for_each": {"rate": "±100, ±50 deg/s"}, "repeat": draw(st.integers(1, 3))},
                {"label": "end-zero"},
            ],
        }
        return [entry], {"estimator": "scale_factor_tilted", "segments": "series"}
    if form == "triad":
        count = draw(st.sampled_from([6, 12, 24]))
        entry = {**state, "label": "P", "for_each": {"orientation": _six_or_more(count)}}
        entry.pop("orientation")
        if bool(gyros) and draw(st.booleans()):
            return [entry], {
                "estimator": "imu_multi_position",
                "segments": "P",
                "gyros": gyros,
                "accelerometers": accels,
                **basis,
            }
        reference = draw(st.sampled_from(["orientation", "gravity_magnitude"]))
        return [entry], {
            "estimator": "accelerometer_multi_position",
            "segments": "P",
            "outputs": accels,
            "reference": reference,
            **basis,
        }
    if form == "still":
        estimator = draw(
            st.sampled_from(["accelerometer_multi_position", "imu_multi_position", "scale_factor", "repeatability"])
        )
        detection: dict[str, Any] = {
            "detect": "still",
            "within": draw(st.sampled_from(["P", "P", "*"])),
            "window": "0.1 s",
            "threshold": "1 m/s^2",
            "at_least": "0.2 s",
        }
        estimate: dict[str, Any] = {"estimator": estimator, "segments": detection}
        if estimator == "accelerometer_multi_position":
            estimate |= {"reference": "gravity_magnitude"}
        if estimator == "repeatability":
            estimate |= {"channels": names[:1]}
        if draw(st.booleans()):
            detection["channels"] = draw(st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True))
        entry = {**state, "label": "P", "for_each": {"orientation": _six_or_more(12)}}
        entry.pop("orientation")
        return [entry], estimate
    if form == "navigate":
        return [
            {**state, "label": "align"},
            {**state, "label": "go", **draw(motions(draft, float(dwell.split()[0])))},
        ], {"estimator": "strapdown_navigation", "segments": ["align", "go"]}
    if form == "rocking":
        entry = {
            **state,
            "label": "S",
            "steps": [
                {"label": "static", "mode": "caged"},
                {"label": "drift", "mode": "navigation", **draw(motions(draft, float(dwell.split()[0])))},
            ],
        }
        return [entry], {"estimator": "rocking_drift", "segments": "*", "release": "0.5 s", "window": "0.2 s"}
    chosen = draw(st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True))
    if form == "temperature":
        thermometer = [name for name in names if "temperature" in name]
        entry = {
            **state,
            "label": "T",
            "for_each": {
                "temperature": draw(st.sampled_from([["-20 degC", "20 degC", "50 degC"], ["10 degC", "30 degC"]]))
            },
        }
        estimate = {"estimator": "temperature_model", "segments": "T", "channels": chosen}
        return [entry], {
            **estimate,
            **({"temperature_channel": thermometer[0]} if bool(thermometer) and draw(st.booleans()) else {}),
        }
    if form == "repeat":
        return [{**state, "label": "B", "repeat": draw(st.integers(1, 4))}], {
            "estimator": "repeatability",
            "segments": "B",
            "channels": chosen,
        }
    entry = {**state, "label": "A", "dwell": draw(between("s", 0.1, 30)), "repeat": draw(st.integers(1, 2))}
    estimate = {"estimator": "allan_deviation", "segments": "A", "outputs": chosen}
    if draw(st.booleans()):
        estimate["taus"] = draw(st.sampled_from([["0.1 s", "0.2 s", "1 s"], ["100 s"], ["1 s", "20 s"]]))
    if draw(st.booleans()):
        estimate["fit_up_to"] = draw(st.sampled_from(["0.05 s", "1 s", "5 h"]))
    return [entry], estimate


def left_to_the_data(plan: Plan) -> bool:
    """Whether only the samples show if the estimate can be made: stillness in whatever the plan holds besides its poses, and the Allan
    deviation of readings whose changes no model declares, such as those of an encoder."""
    estimate = plan["estimates"].get("learnt", {})
    if estimate.get("estimator") == "allan_deviation":
        sensor = Draft(plan["bench"], wild=False).sensor
        heard = [output for output in sensor.outputs if output.name in estimate["outputs"]]
        return any(output.noise.white == 0 and not output.constant for output in heard)
    chosen = estimate.get("segments")
    return isinstance(chosen, dict) and chosen["within"] == "*"


@st.composite
def plans(draw: st.DrawFn) -> Plan:
    """A whole plan, as the data of its file."""
    draft = Draft(draw(st.sampled_from(VIRTUAL)), draw(st.integers(0, 7)) == 0)
    entries, estimates = [], {}
    if draw(st.integers(0, 2)):
        found, estimate = draw(estimable(draft))
        entries += found
        estimates["learnt"] = estimate
    count = draw(st.integers(0 if entries else 1, 4))
    entries += [draw(segments(draft, f"S{number}")) for number in range(count)]
    defaults = {
        "orientation": draw(orientations(draft)) if draw(st.integers(0, 3)) == 0 else UPRIGHT,
        "settle": draw(st.sampled_from(["0 s", "1 s"])),
        "dwell": draw(between("s", 0.1, 2)),
    }
    return {
        "planrunner": 1,
        "title": "written by hypothesis",
        "bench": draft.bench,
        "sensor": {"kind": draft.sensor.kind, "outputs": [draft.sensor.outputs[0].name]},
        "defaults": defaults,
        "segments": entries,
        "estimates": estimates,
        "report": ["summary.md"],
    }
