"""The ellipsoid against published figures and a second formula."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.navigation.wgs84 import normal_gravity, radii, separation


def test_gravity_at_equator_and_pole_and_between() -> None:
    assert float(normal_gravity(0.0)) == pytest.approx(9.7803253359, abs=1e-10)
    assert float(normal_gravity(np.pi / 2)) == pytest.approx(9.8321849379, abs=1e-9)
    # GRS 80 has the same normal gravity to 1e-6 m/s^2; Moritz (Journal of Geodesy 74, 2000) gives 9.806199203 at 45 deg.
    assert float(normal_gravity(np.pi / 4)) == pytest.approx(9.806199203, abs=2e-6)


@pytest.mark.parametrize("latitude", [-60.0, 0.0, 30.0, 80.0])
def test_gravity_above_the_ellipsoid_against_the_potential(latitude: float) -> None:
    """Gravitation of the ellipsoid by its zonal harmonics to degree 8 and the centrifugal acceleration, not the series in height."""
    import pyins.earth

    phi = np.radians(latitude)
    gm, a, omega = 3.986004418e14, 6378137.0, 7.292115e-5
    e2 = pyins.earth.E2
    j2 = 1.082629821e-3
    harmonics = {2: j2}
    for n in (2, 3, 4):  # Heiskanen and Moritz, Physical Geodesy, (2-92)
        harmonics[2 * n] = (-1) ** (n + 1) * 3 * e2**n / ((2 * n + 1) * (2 * n + 3)) * (1 - n + 5 * n * j2 / e2)
    height = 8000.0
    east = a / np.sqrt(1 - e2 * np.sin(phi) ** 2)
    p, z = (east + height) * np.cos(phi), (east * (1 - e2) + height) * np.sin(phi)

    def potential(p: float, z: float) -> float:
        r = np.hypot(p, z)
        series = sum(
            j * (a / r) ** n * np.polynomial.legendre.legval(z / r, [0] * n + [1]) for n, j in harmonics.items()
        )
        return gm / r * (1 - series) + 0.5 * omega**2 * p**2

    step = 50.0
    down = -(
        potential(p + step * np.cos(phi), z + step * np.sin(phi))
        - potential(p - step * np.cos(phi), z - step * np.sin(phi))
    ) / (2 * step)
    assert float(normal_gravity(phi, height)) == pytest.approx(down, abs=1e-5)


def test_radii_at_forty_five_degrees() -> None:
    north, east = radii(np.pi / 4)
    # a(1 − e²)/(1 − e²/2)^(3/2) and a/(1 − e²/2)^(1/2) worked by hand with e² = 0.00669437999014
    assert float(north) == pytest.approx(6367381.8156, abs=1e-3)
    assert float(east) == pytest.approx(6388838.2901, abs=1e-3)


def test_separation_across_the_date_line_and_of_long_ways() -> None:
    east, north = separation(0.3, np.pi - 1e-6, 0.3, -np.pi + 1e-6)
    assert float(east) == pytest.approx(2e-6 * 6378693 * np.cos(0.3), rel=1e-3)
    assert float(north) == 0.0
    # A meridian arc of 1 degree at 45 degrees is 111131.745 m (any geodetic table).
    _, north = separation(np.radians(44.5), 0.0, np.radians(45.5), 0.0)
    assert float(north) == pytest.approx(111131.745, abs=1.0)
