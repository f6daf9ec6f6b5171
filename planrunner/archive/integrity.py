"""What is raised when a run folder is not what was written (exit code 4)."""

from __future__ import annotations


class IntegrityError(Exception):
    """A file of a run folder is missing, changed or not as its schema says. The message says which, and what to do."""
