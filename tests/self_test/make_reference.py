"""Makes the reference recordings in plans/self_test: `python tests/self_test/make_reference.py`.

Written apart from planrunner, so that the answers do not depend on what they check: the flexure gyro's pulses come from the formulas of the
method with numbers chosen here; the straight line is NIST's Norris data set (NIST StRD, linear regression, certified values).
"""

import math
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "plans" / "self_test"
SAMPLES, INTERVAL, GAP = 10, 0.1, 5.0

# Chosen coefficients: scale factors in (deg/h)/(pulse/s), angles in arcmin, drifts in deg/h and deg/h/g.
COEFFICIENTS = {
    "SF_X": 0.021, "SF_Y": 0.019, "epsilon": 12.0, "xi": -7.0,
    "D_X_F": 1.75, "D_X_X": -3.2, "D_X_Y": 0.85, "D_X_Z": 0.11,
    "D_Y_F": -2.4, "D_Y_X": 0.6, "D_Y_Y": 2.9, "D_Y_Z": -0.07,
}  # fmt: skip
LATITUDE, EARTH_RATE = math.radians(39.98), 15.041067
DIRECTION = {
    "up": (0, 0, 1), "down": (0, 0, -1), "north": (0, 1, 0), "south": (0, -1, 0), "east": (1, 0, 0), "west": (-1, 0, 0),
}  # fmt: skip
POSITIONS = {
    "P1": "up north west", "P2": "down north east", "P3": "north up east", "P4": "north down west",
    "P5": "east south down", "P6": "south east up", "P7": "west south up", "P8": "south west down",
}  # fmt: skip

# NIST Standard Reference Datasets, "Norris": y (instrument) against x (reference).
NORRIS = """0.1 0.2  338.8 337.4  118.1 118.2  888.0 884.6  9.2 10.1  228.1 226.5  668.5 666.3  998.5 996.3  449.1 448.6
778.9 777.0  559.2 558.2  0.3 0.4  0.1 0.6  778.1 775.5  668.8 666.9  339.3 338.0  448.9 447.5  10.8 11.6  557.7 556.0
228.3 228.1  998.0 995.8  888.8 887.6  119.6 120.2  0.3 0.3  0.6 0.3  557.6 556.8  339.3 339.1  888.0 887.2  998.5 999.0
778.9 779.0  10.2 11.1  117.6 118.3  228.9 229.2  668.4 669.1  449.2 448.9  0.2 0.5"""


def pulses(words: str) -> tuple[float, float]:
    """The two torquer outputs at rest, pulse/s, by i = U0 + U1 w_Y + U2 w_X + U3 a_X + U4 a_Y + U5 a_Z and likewise V."""
    c = COEFFICIENTS
    eps, xi = math.radians(c["epsilon"] / 60), math.radians(c["xi"] / 60)
    earth = (0.0, EARTH_RATE * math.cos(LATITUDE), EARTH_RATE * math.sin(LATITUDE))
    axes = [DIRECTION[word] for word in words.split()]
    w_x, w_y, _ = (sum(a * b for a, b in zip(axis, earth, strict=True)) for axis in axes)
    a_x, a_y, a_z = (float(axis[2]) for axis in axes)
    d_x = c["D_X_F"] + c["D_X_X"] * a_x + c["D_X_Y"] * a_y + c["D_X_Z"] * a_z
    d_y = c["D_Y_F"] + c["D_Y_X"] * a_x + c["D_Y_Y"] * a_y + c["D_Y_Z"] * a_z
    u1, u2 = math.cos(eps + xi) / (c["SF_Y"] * math.cos(xi)), math.sin(eps + xi) / (c["SF_Y"] * math.cos(xi))
    v1, v2 = -math.sin(eps) / (c["SF_X"] * math.cos(xi)), math.cos(eps) / (c["SF_X"] * math.cos(xi))
    return u1 * (w_y + d_x) + u2 * (w_x + d_y), v1 * (w_y + d_x) + v2 * (w_x + d_y)


def write(name: str, header: list[str], rows: dict[str, tuple[float, ...]], swing: float) -> None:
    """One short stretch of samples a label, alternating by ± swing about the value, and the table of the stretches."""
    with (
        (FOLDER / f"{name}.csv").open("w", newline="\n") as data,
        (FOLDER / f"{name}.segments.csv").open("w", newline="\n") as table,
    ):
        data.write(",".join(["time_s", *header]) + "\n")
        table.write("label,start_s,end_s\n")
        for number, (label, values) in enumerate(rows.items()):
            start = number * GAP
            for sample in range(SAMPLES):
                sign = 1 if sample % 2 else -1
                cells = [f"{start + sample * INTERVAL:.1f}", *(repr(value + sign * swing) for value in values)]
                data.write(",".join(cells) + "\n")
            table.write(f"{label},{start:.1f},{start + SAMPLES * INTERVAL:.1f}\n")


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    write(
        "eight_position", ["torquer_x", "torquer_y"], {label: pulses(words) for label, words in POSITIONS.items()}, 1.0
    )
    numbers = [float(word) for word in NORRIS.split()]
    pairs = list(zip(numbers[::2], numbers[1::2], strict=True))
    write("norris", ["output"], {f"N{i:02d}": (y,) for i, (y, _) in enumerate(pairs, 1)}, 0.5)
    print("\n".join(f"        N{i:02d}: {x:g} deg/s" for i, (_, x) in enumerate(pairs, 1)))


if __name__ == "__main__":
    main()
