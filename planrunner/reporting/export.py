"""Writes coefficients as files for other tools: CSV, MATLAB, YAML and C header, in full precision with units and covariance.

Texts of names, units and descriptions are escaped, so that they cannot end the field, comment or string that contains them.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping

from planrunner.estimators.interface import Coefficient, Estimate

M_WORDS = frozenset(
    (
        "break",
        "case",
        "catch",
        "classdef",
        "continue",
        "else",
        "elseif",
        "end",
        "for",
        "function",
        "global",
        "if",
        "otherwise",
        "parfor",
        "persistent",
        "return",
        "spmd",
        "switch",
        "try",
        "while",
    )
)


class ExportError(Exception):
    """Reports that coefficients cannot be written in this form. The message gives the reason."""


def export(estimate: Estimate, form: str, provenance: Mapping[str, str] | None = None) -> str:
    """Returns the text of one file of coefficients. `form`: csv, matlab, yaml or c (see `FORMS`). `provenance`: facts that the
    comment at the beginning of the file states.

    Raises `ExportError` for an unknown form.
    """
    if form not in FORMS:
        raise ExportError(f"coefficients cannot be exported as '{form[:40]}'; known: {', '.join(FORMS)}")
    return FORMS[form](estimate, dict(provenance or {}))


def identifiers(names: Iterable[str], words: frozenset[str] = frozenset()) -> list[str]:
    """Converts the names to valid identifiers of programming languages, in the same order. The identifiers are distinct even if
    case is ignored."""
    taken: set[str] = set()
    result = []
    for name in names:
        base = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")[:50] or "coefficient"
        if base[0].isdigit() or base in words:
            base = f"c_{base}"
        candidate, count = base, 2
        while candidate.lower() in taken:
            candidate, count = f"{base}_{count}", count + 1
        taken.add(candidate.lower())
        result.append(candidate)
    return result


def comment(text: str) -> str:
    """Returns a text in a form that cannot end a comment in any of the four languages: one line, printable, without `*/` and
    without a trailing backslash."""
    line = "".join(char if char.isprintable() else " " for char in text)
    line = " ".join(line.split()).replace("*/", "* /").replace("/*", "/ *").replace("??/", "? ?/")
    return line.rstrip("\\ ")


def _opening(estimate: Estimate, provenance: Mapping[str, str]) -> list[str]:
    lines = [f"Coefficients of the estimate {estimate.name} by {estimate.estimator}"]
    lines += [f"{name}: {value}" for name, value in provenance.items()]
    return [comment(line) for line in lines]


def _csv(estimate: Estimate, provenance: Mapping[str, str]) -> str:
    """Returns the CSV text with the columns name, value, unit, standard_uncertainty, degrees_of_freedom, description, period.
    Comment lines begin with `#`. The column `period` contains the period of a circular quantity in the unit of the quantity; for
    any other quantity it is empty."""
    out = io.StringIO()
    for line in _opening(estimate, provenance):
        out.write(f"# {line}\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("name", "value", "unit", "standard_uncertainty", "degrees_of_freedom", "description", "period"))
    for item in estimate.coefficients:
        numbers = (repr(float(item.value)), _cell(item.unit), repr(float(item.standard_uncertainty)))
        words = (repr(float(item.degrees_of_freedom)), _cell(item.description))
        period = repr(float(item.period)) if math.isfinite(item.period) else ""
        writer.writerow((_cell(item.name), *numbers, *words, period))
    return out.getvalue()


def _cell(text: str) -> str:
    """Returns a text on one line, in a form that spreadsheets do not interpret as a formula."""
    line = " ".join("".join(char if char.isprintable() else " " for char in text).split())
    return f"'{line}" if line[:1] in ("=", "+", "-", "@") else line


def _matlab(estimate: Estimate, provenance: Mapping[str, str]) -> str:
    """Returns a MATLAB script that sets a struct. The struct contains value, unit, u and nu of every coefficient, the period of
    circular quantities, the names, and the covariance matrix."""
    root = identifiers([estimate.name], M_WORDS)[0]
    fields = identifiers([item.name for item in estimate.coefficients], M_WORDS)
    lines = [f"% {line}" for line in _opening(estimate, provenance)]
    for name, item in zip(fields, estimate.coefficients, strict=True):
        lines += [
            f"{root}.{name}.value = {_m(item.value)};  % {comment(item.unit)}",
            f"{root}.{name}.standard_uncertainty = {_m(item.standard_uncertainty)};  % {comment(item.unit)}",
            f"{root}.{name}.degrees_of_freedom = {_m(item.degrees_of_freedom)};",
            f"{root}.{name}.unit = {_m_text(item.unit)};",
        ]
        if math.isfinite(item.period):
            lines.append(f"{root}.{name}.period = {_m(item.period)};  % {comment(item.unit)}")
    names = ", ".join(_m_text(item.name) for item in estimate.coefficients)
    lines.append(f"{root}_names = {{{names}}};")
    rows = "; ...\n  ".join(" ".join(_m(value) for value in row) for row in estimate.covariance.tolist())
    lines.append(f"% covariance in the order of {root}_names, in the products of their units")
    lines.append(f"{root}_covariance = [{rows}];")
    return "\n".join(lines) + "\n"


def _m(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    if math.isinf(value):
        return "Inf" if value > 0 else "-Inf"
    return repr(float(value))


def _m_text(text: str) -> str:
    """Returns a character vector of MATLAB. Quotes are doubled; no other character is special."""
    return "'" + comment(text).replace("'", "''") + "'"


def _yaml(estimate: Estimate, provenance: Mapping[str, str]) -> str:
    import yaml

    data = {
        "estimate": estimate.name,
        "estimator": estimate.estimator,
        "provenance": dict(provenance),
        "coefficients": {
            item.name: {
                "value": _Exact(item.value),
                "unit": item.unit,
                "standard_uncertainty": _Exact(item.standard_uncertainty),
                "degrees_of_freedom": _Exact(item.degrees_of_freedom),
                "description": str(item.description),
            }
            | ({"period": _Exact(item.period)} if math.isfinite(item.period) else {})
            for item in estimate.coefficients
        },
        "covariance": [[_Exact(value) for value in row] for row in estimate.covariance.tolist()],
    }

    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: object) -> bool:
            return True

    def exact(dumper: yaml.SafeDumper, value: _Exact) -> yaml.ScalarNode:
        return dumper.represent_scalar("tag:yaml.org,2002:float", yaml_float(float(value)))

    Dumper.add_representer(_Exact, exact)
    opening = "".join(f"# {line}\n" for line in _opening(estimate, provenance))
    return opening + yaml.dump(
        data, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None
    )


class _Exact(float):
    """A float that is written in a form that YAML 1.1 and 1.2 readers accept as a number."""


def yaml_float(value: float) -> str:
    """Returns a number in full precision with a point and a signed exponent: `1.0e+22`, not `1e22`, which YAML 1.1 reads as text."""
    if math.isnan(value):
        return ".nan"
    if math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    mantissa, mark, exponent = repr(value).partition("e")
    if "." not in mantissa:
        mantissa += ".0"
    return f"{mantissa}e{int(exponent):+03d}" if mark else mantissa


def _c(estimate: Estimate, provenance: Mapping[str, str]) -> str:
    """Returns a header of constants for C and C++: value and standard uncertainty of every coefficient, and the period of circular
    quantities."""
    root = identifiers([estimate.name])[0].upper()
    constants = [constant for item in estimate.coefficients for constant in _constants(item)]
    names = identifiers(name for name, _, _ in constants)
    guard = f"PLANRUNNER_{root}_H"
    lines = [f"/* {line} */" for line in _opening(estimate, provenance)]
    lines += [f"#ifndef {guard}", f"#define {guard}", ""]
    for name, (_, value, about) in zip(names, constants, strict=True):
        lines.append(f"#define {root}_{name.upper()} ({value!r}) /* {comment(about)} */")
    return "\n".join([*lines, "", "#endif", ""])


def _constants(item: Coefficient) -> list[tuple[str, float, str]]:
    """Returns name, value and comment of each constant that describes a coefficient. Raises `ExportError` for non-finite values."""
    if not (math.isfinite(item.value) and math.isfinite(item.standard_uncertainty)):
        raise ExportError(f"{item.name} is not a finite number, which a C header cannot represent")
    found = [
        (item.name, float(item.value), item.unit),
        (f"{item.name}_STANDARD_UNCERTAINTY", float(item.standard_uncertainty), f"standard uncertainty, {item.unit}"),
    ]
    if math.isfinite(item.period):
        found.append((f"{item.name}_PERIOD", float(item.period), f"period, {item.unit}"))
    return found


FORMS: dict[str, Callable[[Estimate, Mapping[str, str]], str]] = {
    "csv": _csv,
    "matlab": _matlab,
    "yaml": _yaml,
    "c": _c,
}
