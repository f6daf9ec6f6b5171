"""Reports: from a context and a template to text."""

from __future__ import annotations

from pathlib import Path

from planrunner.estimators.limits import LimitVerdict
from planrunner.reporting.context import ReportContext, SegmentSummary
from planrunner.reporting.templates import ReportError, available, render
from planrunner.reporting.view import report_view

__all__ = ["LimitVerdict", "ReportContext", "ReportError", "SegmentSummary", "available", "render_report"]


def render_report(context: ReportContext, template: str, folder: Path | None = None) -> str:
    """The report made from the context with `template` (such as `report.html` or `summary.md`): one self-contained text.

    folder: a user's template folder, searched before the shipped one. The same context gives the same text.
    Raises `ReportError`.
    """
    return render(template, report_view(context), folder)
