"""Mutations of plans for the tests: of their structure, and of their bytes. Everything is drawn from a seeded generator."""

from __future__ import annotations

import copy
import json
import random
from pathlib import Path
from typing import Any

from planrunner.plan import source

ROOT = Path(__file__).resolve().parents[2]
SHIPPED_PLANS = sorted((ROOT / "plans").glob("*.yaml"))

VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 5, 2.5, 1e-3, 1e300, 10**25, float("nan"), float("inf"), 1.0, ""),
    *(
        "rest",
        "unknown",
        "recorded",
        "still",
        "up",
        "down",
        "x",
        "*",
        "P*",
        "a/b",
        "#",
        "true",
        "null",
        "~",
        "0777",
        "12:30",
        "no",
    ),
    *(
        "5",
        "5.",
        ".5",
        "1e-3",
        "-40 degC",
        "25 °C",
        "300 deg/s",
        "±300 deg/s",
        "±300, ±150 deg/s",
        "1, 2 s",
        "1,5 deg/s",
        "1, 5",
    ),
    *(
        "9**9**9 deg/s",
        "nan deg/s",
        "inf s",
        "1e999 s",
        "1e-99 s",
        "5 apples",
        "5 m^6^6",
        "5 deg ± 3",
        "5 ± 3 deg",
        "5 deg ± 3 s",
    ),
    *(
        "5 deg +/- 3 arcmin",
        "−5 deg",
        "5 deg\n",
        " 5 s ",
        "5\u00a0s",
        "0 s",
        "-5 s",
        "0.2 Hz",
        "2 min",
        "12 h",
        "30 K",
        "± 5 K",
        "+-5 K",
    ),
    *(
        "x 30 deg",
        "x 30",
        "y  30 deg",
        "w 30 deg",
        "x 30 deg ± 1 deg",
        "A +180 C",
        "A 1.2.3 C",
        "A B",
        "drift.D_X_F",
        "drift",
        "P1\n",
    ),
    *(
        "label {rate}",
        "label {nothing}",
        "a" * 81,
        "flexure_gyro_static",
        "scale_factor",
        "no_such_estimator",
        "shuffled",
        "report.html",
    ),
    *(
        [],
        {},
        [None],
        [[]],
        [1, 0, 0, 0],
        [1, 0, 0],
        [0, 0, 0, 0],
        ["5 s"],
        ["5 s", 3],
        [True],
        {"": 1},
        {"a": {"b": {"c": []}}},
    ),
    *(
        {"value": "5 deg"},
        {"value": "5 deg", "half_width": "1 deg"},
        {"value": "5 s", "half_width": "1 s", "distribution": "normal"},
    ),
    *(
        {"value": "5 s", "standard_uncertainty": "1 s", "degrees_of_freedom": 0},
        {"value": {"value": "5 s"}},
        {"half_width": "5 s"},
    ),
    *(
        {"value": "5 s", "distribution": "flat"},
        {"value": "5 s", "degrees_of_freedom": float("nan")},
        {"turns": 1},
        {"turns": 0},
    ),
    *(
        {"turns": 2.0, "at_least": "30 s"},
        {"ramp_to": "60 degC"},
        {"rate": "10 deg/s"},
        {"rock": {"amplitude": "3 deg"}},
    ),
    *(
        {"x": "up", "y": "north"},
        {"x": "up"},
        {"x": "up", "y": "up"},
        {"x": "up", "y": "west", "z": "north"},
        {"x": "sideways", "y": "up"},
    ),
    *(
        {"x": "up", "y": 5},
        {"x": "up", "rotate": ["x 30 deg"]},
        {"rotate": ["x 30 deg"]},
        {"from": {"x": "up"}, "rotate": []},
    ),
    *(
        {"quaternion": [1, 0, 0, 0]},
        {"quaternion": [1, 0, 0, True]},
        {"quaternion": 5},
        {"quaternion": [1, 0, 0, 0], "x": "up"},
    ),
    *({"detect": "still", "window": "0.5 s", "threshold": "0.05 m/s^2", "at_least": "1 s"}, {"detect": "moving"}),
    *({"rate": "±300, ±150 deg/s"}, {"rate": ["±300 deg/s", "5 deg/s"]}, {"rate": {"a/b": "5 deg/s"}}, {"colour": [1]}),
)
KEYS = (
    *(
        "rate",
        "motion",
        "temperature",
        "soak",
        "settle",
        "dwell",
        "label",
        "for_each",
        "order",
        "repeat",
        "steps",
        "orientation",
    ),
    *(
        "estimator",
        "segments",
        "uses",
        "limits",
        "report",
        "x",
        "planrunner",
        "title",
        "mounting",
        "value",
        "rock",
        "cycle",
        "moves",
    ),
    *(
        "",
        "lable",
        "0",
        "<<",
        "a/b",
        "é",
        "a b",
        "quaternion",
        "from",
        "rotate",
        "within",
        "at_least",
        "description",
        "bench",
    ),
)


def examples() -> list[dict[str, Any]]:
    """The shipped plans as plain data."""
    return [source.plain(source.load(path)) for path in SHIPPED_PLANS]


def as_yaml(data: Any) -> str:
    """JSON is YAML; figures that JSON lacks are spelled as YAML has them."""
    text = json.dumps(data)
    return text.replace("NaN", ".nan").replace("-Infinity", "-.inf").replace("Infinity", ".inf")


def mutate(data: Any, draw: random.Random, donors: list[Any], times: int = 1) -> Any:
    """A copy of `data` with parts dropped, renamed, exchanged or replaced."""
    data = copy.deepcopy(data)
    for _ in range(times):
        places = list(_places(data))
        holder, key = draw.choice(places)
        what = draw.randrange(6)
        if what == 0:
            del holder[key]
        elif what == 1 and isinstance(holder, dict):
            name = draw.choice(KEYS) if draw.random() < 0.7 else _misspelt(key, draw)
            holder[name] = holder.pop(key)
        elif what == 2:
            other_holder, other_key = draw.choice(list(_places(draw.choice(donors))))
            holder[key] = copy.deepcopy(other_holder[other_key])
        elif what == 3 and isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        elif what == 3:
            holder[draw.choice(KEYS)] = copy.deepcopy(draw.choice(VALUES))
        elif what == 4:
            holder[key] = draw.choice(([holder[key]], {draw.choice(KEYS): holder[key]}))
        else:
            holder[key] = copy.deepcopy(draw.choice(VALUES))
        if not data:
            break
    return data


def _places(data: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    queue = [data]
    while queue:
        item = queue.pop()
        entries = item.items() if isinstance(item, dict) else enumerate(item) if isinstance(item, list) else ()
        for key, value in entries:
            found.append((item, key))
            queue.append(value)
    return found


def _misspelt(word: str, draw: random.Random) -> str:
    at = draw.randrange(len(word) + 1)
    return draw.choice((word[:at] + word[at + 1 :], word[:at] + "e" + word[at:], word[::-1], word.upper()))


_BYTES = (
    *(
        b"\x00",
        b"\xff",
        b"\xef\xbb\xbf",
        b"\t",
        b"\r",
        b"\n",
        b" ",
        b"- ",
        b": ",
        b"[",
        b"]",
        b"{",
        b"}",
        b"&a ",
        b"*a",
        b"!!python/object:os ",
    ),
    *(
        b"'",
        b'"',
        b"|\n",
        b">\n",
        b"#",
        b"%",
        b"@",
        b"`",
        b"? ",
        b"---\n",
        b"...\n",
        b"<<: ",
        b"\xe2\x80\xa8",
        b"\xc2\xb1",
        b"9" * 40,
    ),
    *(
        b"\xe2\x88\x92",
        b"9**9**9 deg/s",
        b"1e99999",
        b"[" * 60,
        b"{a: " * 60,
        b"- " * 60,
        b"\\",
        b"\\u0000",
        b"0x",
        b"for_each: {rate: ",
    ),
)


def mutate_bytes(data: bytes, draw: random.Random, times: int = 1) -> bytes:
    """`data` with bytes dropped, repeated, inserted or flipped, or with lines exchanged."""
    for _ in range(times):
        at = draw.randrange(len(data) + 1)
        what = draw.randrange(6)
        if what == 0:
            data = data[:at] + data[at + draw.randrange(1, 20) :]
        elif what == 1:
            data = data[:at] + draw.choice(_BYTES) + data[at:]
        elif what == 2:
            until = at + draw.randrange(1, 60)
            data = data[:until] + data[at:]
        elif what == 3 and at < len(data):
            data = data[:at] + bytes([data[at] ^ (1 << draw.randrange(8))]) + data[at + 1 :]
        elif what == 4:
            lines = data.split(b"\n")
            first, second = draw.randrange(len(lines)), draw.randrange(len(lines))
            lines[first], lines[second] = lines[second], lines[first]
            data = b"\n".join(lines)
        else:
            until = at + draw.randrange(1, 8)
            data = data[:at] + bytes(draw.choice(b"0123456789.eE+-*^/ ") for _ in data[at:until]) + data[until:]
    return data
