"""Segments of a sensor that is rotated relative to the plan: sensitivity of observations to errors of azimuth and position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.physics.kinematics import rotation_about
from planrunner.plan.schedule import Segment, Spin

DIRECTIONS = {"east": (1.0, 0.0, 0.0), "north": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0)}
UP = DIRECTIONS["up"]


def turned(segments: Sequence[Segment], about: tuple[float, float, float], angle: float) -> tuple[Segment, ...]:
    """The segments with the sensor and the axes of spins turned by `angle` [rad] about a direction, East-North-Up.

    On a bench whose azimuth is larger by `angle` than believed, table and sensor are turned by −angle about up.
    """
    turn = rotation_about(about, angle)
    found = []
    for segment in segments:
        attitude = None if segment.attitude is None else np.asarray(segment.attitude @ turn.T)
        motion = segment.motion
        if isinstance(motion, Spin):
            east, north, up = (turn @ np.asarray(motion.about, dtype=float)).tolist()
            motion = replace(motion, about=(east, north, up))
        found.append(replace(segment, attitude=attitude, motion=motion))
    return tuple(found)
