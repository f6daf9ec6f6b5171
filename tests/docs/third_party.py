"""A package of `docs/examples`, installed as pip would install it, into a folder of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs" / "examples"

Planrunner = Callable[..., "subprocess.CompletedProcess[str]"]


def shown_whole(page: str, package: str) -> bool:
    """Whether a page of the docs shows the package's module and entry point as they are."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    module = (EXAMPLES / package / f"{package}.py").read_text(encoding="utf-8").rstrip()
    entry = (EXAMPLES / package / "pyproject.toml").read_text(encoding="utf-8").split("\n\n")[2]
    return f"```python\n{module}\n```" in text and f"```toml\n{entry}\n```" in text


def installed(package: str, folder: Path) -> Planrunner:
    """Install the example beneath `folder`; returns the `planrunner` command that sees it and works in `folder`."""
    site = folder / "site"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--no-build-isolation", "--target", str(site), str(EXAMPLES / package)]
    subprocess.run(command, check=True, capture_output=True)
    environment = {**os.environ, "PYTHONPATH": str(site)}

    def planrunner(*arguments: str) -> subprocess.CompletedProcess[str]:
        whole = [sys.executable, "-m", "planrunner", *arguments]
        return subprocess.run(whole, capture_output=True, text=True, env=environment, cwd=folder)

    return planrunner
