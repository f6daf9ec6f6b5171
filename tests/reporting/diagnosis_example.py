"""A diagnosis as plain data, made up to fill every table and picture of the page."""

from __future__ import annotations

import math
from typing import Any

CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
SEGMENTS = [f"S{n:02}" for n in range(1, 13)] + [f"Rx{rate:+d}" for rate in (10, -10, 30, -30, 60, -60)] + ["ramp-20"]
EFFECTS = ["gyro_g_sensitivity", "gyro_g2_sensitivity", "lever_arm", "table_tilt"]


def diagnosis(kind: str = "effect", **changes: Any) -> dict[str, Any]:
    """kind: of the verdict."""
    effects = {"effect": ["gyro_g_sensitivity"], "pair": ["gyro_g_sensitivity", "lever_arm"]}.get(kind, [])
    alike = ["gyro_g_sensitivity", "table_tilt"] if kind == "indistinguishable" else []
    posterior = {
        "none": 0.0004,
        "gyro_g_sensitivity": 0.9612,
        "gyro_g_sensitivity+lever_arm": 0.021,
        "table_tilt": 0.0124,
        "lever_arm": 0.001,
        "unknown": 0.004,
    }
    if kind in ("none", "unknown"):
        other = {"none": "unknown", "unknown": "none"}[kind]
        posterior = {kind: 0.97, other: 0.01, "gyro_g_sensitivity": 0.02}
    found = {
        "planrunner_diagnosis": 1,
        "named": [
            {"effect": name, "name": f"plain {name}", "physics": "Some physics.", "actor": "sensor", "remedy": "Act: k_zx 0.00412."}
            for name in effects
        ],
        "gap": {
            name: {"before": 0.004 if name[0] == "g" else 0.0021, "noise_floor": 0.002, "unit": "deg/s" if name[0] == "g" else "m/s^2"}
            for name in CHANNELS
        },
        "where": [
            {"channel": "gyro_z", "factor": "orientation", "level": "x up, y north, z west", "share": 0.61, "p": 0.0025},
            {"channel": "gyro_x", "factor": "table_angle", "level": "1 per turn", "share": 0.04, "p": 0.31},
        ],
        "posterior": posterior,
        "verdict": {"kind": kind, "effects": effects, "class": alike},
        "ambiguity_set": [name for name, p in posterior.items() if p > 0.5],
        "absorbed": [{"effect": "table_rate_error", "kept_share": 0.0}],
        "parameters": [
            {"effect": "gyro_g_sensitivity", "name": "k_zx", "value": 0.00412, "unit": "deg/s/g", "standard_uncertainty": 0.00003}
        ],
        "closure": {"before": 5.21, "after": 0.21, "shrinks_by": 0.96, "interval_90": [0.94, 0.978], "resolvable": True},
        "next": {"plan": None, "text": "planrunner: 1\ntitle: What would settle it\n", "expected": "P = 0.98 after 12 min"},
        "priors": {"none": 0.2, "single": 0.5, "pair": 0.15, "unknown": 0.15},
        "pictures": _pictures(),
    }  # fmt: skip
    return found | changes


def _pictures() -> dict[str, Any]:
    frequency = [0.05 * 1.2**n for n in range(34)]
    course = [math.sin(n) for n in range(len(SEGMENTS))]
    return {
        "heat": {
            "segments": SEGMENTS,
            "channels": list(CHANNELS),
            "values": [[1.0 + (40.0 * abs(one) if row < 3 else 0.1) for one in course] for row in range(6)],
        },
        "spectrum": {
            name: {
                "unit": "deg/s/sqrt(Hz)",
                "frequency_hz": frequency,
                "before": [0.002 * (1 + 0.3 / f) for f in frequency],
                "after": [0.002 for _ in frequency],
                "noise": [0.0021 for _ in frequency],
            }
            for name in CHANNELS[:3]
        },
        "means": {
            "segments": SEGMENTS,
            "channels": {
                name: {
                    "unit": "deg/s",
                    "before": [0.004 * one for one in course],
                    "after": [0.0001 * one for one in course],
                    "noise": [0.0003 for _ in course],
                }
                for name in CHANNELS[:3]
            },
        },
        "confusability": {
            "effects": EFFECTS,
            "shares": [[1.0, 0.31, 0.02, 0.98], [0.3, 1.0, 0.0, 0.2], [0.0, 0.01, 1.0, 0.0], [0.95, None, 0.0, 1.0]],
        },
    }
