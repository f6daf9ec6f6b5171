"""Charts: valid SVG, the same every time, with the data in them."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
import reporting_example as example

from planrunner.estimators.tables import Plot
from planrunner.plan.schedule import Cycle, Motion, Move, Rest, Rock, Schedule, Segment
from planrunner.reporting import plots
from planrunner.reporting.timeline import panels_of, spans

SVG = "{http://www.w3.org/2000/svg}"


def rocking() -> Schedule:
    rock = Rock(math.radians(3), 0.2, (0.0, 0.785, 1.571), 480.0)
    cycle = Cycle(
        {"A": 0.0, "C": math.pi}, (Move("A", math.pi, "C"), Move("C", -math.pi, "A")), math.radians(10), 300.0
    )
    planned: tuple[tuple[Motion, float | None], ...] = ((Rest(), 600.0), (rock, 600.0), (cycle, None))
    made = [
        Segment(i, f"s{i}", np.eye(3), "", motion, dwell, start=700.0 * i + 10, transition=10)
        for i, (motion, dwell) in enumerate(planned)
    ]
    return Schedule(tuple(made), 3000.0)


PICTURES = {
    "labels": lambda: plots.plot_svg(example.estimate().plots[0], "k"),
    "line": lambda: plots.plot_svg(Plot("t", "rate, °/s", "y", (1.0, 2.0, 3.5), {"a": (1.0, math.nan, 2.0)}), "k"),
    "logarithmic": lambda: plots.plot_svg(
        Plot("t", "s", "y", (0.1, 1.0, 10.0), {"a": (3.0, 1.0, math.nan)}, {"a": (0.1, 0.2, 0.3)}, log=True), "k"
    ),
    "many": lambda: plots.plot_svg(
        Plot("t", "x", "y", tuple(f"segment {i}" for i in range(90)), {"a": tuple(map(float, range(90)))}), "k"
    ),
    "dollar": lambda: plots.plot_svg(Plot("$x^{$", "$\\frac{", "<y> & z", ("$a$",), {"_hidden": (1.0,)}), "k"),
    "courses": lambda: plots.plot_svg(example.courses(), "k"),
    "interrupted": lambda: plots.plot_svg(
        Plot("t", "s", "y", (0.0, 1.0, 2.0, 3.0), {"a": (1.0, math.nan, 3.0, 4.0)}, {"a": (0.1,) * 4}, lines=True), "k"
    ),
    "empty": lambda: plots.plot_svg(Plot("t", "x", "y", (), {}), "k"),
    "correlation": lambda: plots.correlation_svg(["a", "b"], np.array([[4.0, -3.0], [-3.0, 9.0]]), "k"),
    "names longer than the picture": lambda: plots.correlation_svg(["a" * 90, "b"], np.eye(2), "k"),
    "still": lambda: plots.timeline_svg(example.schedule(), "k"),
    "thermal": lambda: plots.timeline_svg(example.thermal_schedule(), "k"),
    "rocking": lambda: plots.timeline_svg(rocking(), "k"),
}


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_are_valid_named_repeatable_and_alone(name: str) -> None:
    picture = PICTURES[name]()
    root = ElementTree.fromstring(picture)
    assert root.tag == SVG + "svg"
    assert root.find(SVG + "title") is not None
    assert root.find(SVG + "desc") is not None
    assert root.get("width") is None
    assert root.get("viewBox")
    assert root.get("role") == "img"
    ids = re.findall(r'\bid="([^"]*)"', picture)
    assert all(item.startswith("k-") for item in ids)
    referenced = re.findall(r'(?:xlink:href="|url\()#([^")]*)', picture)
    assert set(referenced) <= set(ids)
    assert "<metadata" not in picture
    assert not [element for element in root.iter() if element.get("style") or element.tag == SVG + "style"]
    assert picture == PICTURES[name]()


def test_lettering_is_text_in_a_font_that_is_anywhere() -> None:
    picture = PICTURES["labels"]()
    texts = [element.text for element in ElementTree.fromstring(picture).iter(SVG + "text")]
    assert {"P1", "P8", "position", "residual [pulse/s]", "torquer_x"} <= set(texts)
    assert "sans-serif" in picture


def test_correlation_by_hand() -> None:
    # r = -3 / (2 × 3) = -0.5; a quantity without variance is not correlated with anything.
    covariance = np.array([[4.0, -3.0, 0.0], [-3.0, 9.0, 0.0], [0.0, 0.0, 0.0]])
    expected = [[1.0, -0.5, 0.0], [-0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(plots.correlation(covariance), expected, atol=1e-15)
    assert plots.strong(["a", "b", "c"], plots.correlation(covariance)) == [("a", "b", -0.5)]
    texts = [e.text for e in ElementTree.fromstring(PICTURES["correlation"]()).iter(SVG + "text")]
    assert texts.count("−50") == 2


def test_points_lie_where_the_values_say() -> None:
    plot = Plot("t", "x", "y", ("a", "b", "c"), {"s": (0.0, 1.0, 4.0)})
    picture = plots.plot_svg(plot, "k")
    uses = [e for e in ElementTree.fromstring(picture).iter(SVG + "use") if e.get("fill") == "#0b5394"]
    ys = [float(e.get("y") or "nan") for e in uses][:3]
    # Equal spacing times the values, upwards: (y0 - y2) / (y0 - y1) = 4.
    assert (ys[0] - ys[2]) / (ys[0] - ys[1]) == pytest.approx(4.0, rel=1e-4)


def test_spans_of_a_schedule() -> None:
    first = spans(example.schedule())[0]
    assert (first.leave, first.arrive, first.start, first.end) == (0.0, 1500.0, 2130.0, 2250.0)
    assert panels_of(example.schedule()) == ["segments", "temperature"]
    assert panels_of(example.thermal_schedule()) == ["segments", "temperature", "rate"]
    assert panels_of(rocking()) == ["segments", "rate"]


def drawn_lines(picture: str, colour: str) -> list[list[tuple[float, float]]]:
    """The points of every line that is drawn in a colour and is longer than a legend's."""
    found = []
    for element in ElementTree.fromstring(picture).iter(SVG + "path"):
        if element.get("stroke") == colour:
            pairs = re.findall(r"[ML] (-?[0-9.]+) (-?[0-9.]+)", element.get("d") or "")
            found.append([(float(x), float(y)) for x, y in pairs])
    return [points for points in found if len(points) > 3]


def test_courses_are_lines_without_points_distinguished_without_colour() -> None:
    picture = PICTURES["courses"]()
    root = ElementTree.fromstring(picture)
    texts = [element.text for element in root.iter(SVG + "text")]
    assert {"without rotation", "with rotation", "time [h]"} <= set(texts)
    for colour in plots.COLOURS[:2]:
        assert not [e for e in root.iter(SVG + "use") if e.get("fill") == colour]
        (line,) = drawn_lines(picture, colour)
        assert len(line) > 100
    dashed = [e for e in root.iter(SVG + "path") if e.get("stroke") == plots.COLOURS[1]]
    assert dashed and all(element.get("stroke-dasharray") for element in dashed)
    # The course without rotation ends at 3.1 + 1.4 (1 - cos(2π 24/1.4067)) and so far above that with rotation.
    (still,), (turned,) = (drawn_lines(picture, colour) for colour in plots.COLOURS[:2])
    assert still[-1][1] < turned[-1][1] - 50


def test_a_long_course_keeps_its_peaks_and_gaps() -> None:
    values = np.sin(np.linspace(0, 300, 144_000))
    values[71_234], values[99_000], values[100_000:100_400] = 7.5, -6.25, math.nan
    shown = plots.thinned(values)
    assert len(shown) <= 2000
    assert (np.diff(shown) > 0).all()
    assert shown[0] == 0 and shown[-1] == 143_999
    assert {71_234, 99_000, 100_000} <= set(shown.tolist())
    assert (plots.thinned(values[:2000]) == np.arange(2000)).all()


def test_band_of_a_course() -> None:
    band = Plot("t", "s", "y", (0.0, 1.0, 2.0), {"a": (1.0, 2.0, 3.0)}, {"a": (0.5, 0.5, 0.5)}, lines=True)
    assert plots.plot_svg(band, "k").count('fill-opacity="0.18"') == 1


def test_numbers_beside_logarithmic_axes_are_numbers():
    """Formulas are not drawn: a power of ten would stand there as its markup."""
    wide = plots.plot_svg(
        Plot("Spectrum", "f", "d", (0.1, 1.0, 100.0), {"a": (2.0, 20.0, 4e4)}, log=True, lines=True), "wide"
    )
    narrow = plots.plot_svg(
        Plot("Spectrum", "f", "d", (1.0, 3.0, 8.0), {"a": (0.001, 0.003, 0.004)}, log=True, lines=True), "narrow"
    )
    assert "mathdefault" not in wide + narrow
    assert {"0.1", "10", "1000"} <= set(re.findall(r">([\d.]+)</text>", wide))
    assert {"2", "5", "0.002"} <= set(re.findall(r">([\d.]+)</text>", narrow))


@pytest.mark.parametrize("name", [name for name in PICTURES if name != "names longer than the picture"])
def test_lettering_lies_within_the_picture(name: str) -> None:
    """Both ends of every text, at half its size a letter, which is less than most letters take."""
    root = ElementTree.fromstring(PICTURES[name]())
    _, _, width, height = map(float, (root.get("viewBox") or "").split())
    for text in root.iter(SVG + "text"):
        drawn = text.get("transform") or ""
        moved = re.search(r"translate\((\S+) (\S+)\)", drawn)
        x, y = map(float, moved.groups() if moved else (text.get("x", ""), text.get("y", "")))
        upright = "rotate(-90" in drawn
        long = 0.5 * float((text.get("font-size") or "").removesuffix("px")) * len(text.text or "")
        share = {"start": 0.0, "middle": 0.5, "end": 1.0}[text.get("text-anchor", "start")]
        begin = (y + share * long) if upright else (x - share * long)
        end = begin - long if upright else begin + long
        assert min(begin, end) >= 0 and max(begin, end) <= (height if upright else width), text.text
        assert 0 <= (x if upright else y) <= (width if upright else height), text.text
