"""Error models named in plans: terms found through the entry points `planrunner.terms`, the project's own and everybody else's."""

from __future__ import annotations

from collections.abc import Sequence

from planrunner.base import plugins
from planrunner.error_model.terms import ErrorModel, Term
from planrunner.plan.kinds import Choice


def term_names() -> Choice:
    """The kind of a plan's key that names a term: one of those that are installed."""
    return Choice(plugins.names(plugins.TERMS))


def error_model(names: Sequence[str]) -> ErrorModel:
    """The model of the named terms. Raises `InputError` for a term that is not installed or cannot be loaded."""
    terms: list[Term] = [plugins.load(plugins.TERMS, name) for name in dict.fromkeys(names)]
    return ErrorModel(tuple(terms))
