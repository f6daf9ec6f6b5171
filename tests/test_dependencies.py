"""The lock files: what is installed is pinned by hash, for all that pyproject.toml asks for, from no server in particular."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RUNTIME = PROJECT["dependencies"]
EXTRAS = PROJECT["optional-dependencies"]
LOCKS = {
    "constraints.txt": [*RUNTIME, *EXTRAS["dev"]],
    "constraints-runtime.txt": RUNTIME,
    "constraints-benchmarks.txt": [*RUNTIME, *EXTRAS["dev"], *EXTRAS["bench"]],
}
ENTRY = re.compile(r"(?P<pin>[^\s#-][^\\\n]*?)(?P<hashes>(?: \\\n    --hash=sha256:[0-9a-f]{64})+)\n")


def locked(name: str) -> dict[str, Requirement]:
    """Package → its pin; fails where a line is neither a comment nor a pin with hashes."""
    text = (ROOT / name).read_text(encoding="utf-8")
    pins = [Requirement(entry["pin"]) for entry in ENTRY.finditer(text)]
    rest = [line for line in ENTRY.sub("", text).splitlines() if not line.startswith("#")]
    assert rest == []
    return {canonicalize_name(pin.name): pin for pin in pins}


def version(pin: Requirement) -> str:
    (specifier,) = pin.specifier
    assert specifier.operator == "=="
    return specifier.version


@pytest.mark.parametrize("name", LOCKS)
def test_every_dependency_is_pinned_by_hash_in_a_version_that_the_project_accepts(name: str) -> None:
    pins = locked(name)
    assert len(pins) >= len(LOCKS[name])
    for text in LOCKS[name]:
        wanted = Requirement(text)
        assert wanted.specifier.contains(version(pins[canonicalize_name(wanted.name)])), text


def test_the_locks_agree() -> None:
    runtime, development, benchmarks = (locked(f"constraints{part}.txt") for part in ("-runtime", "", "-benchmarks"))
    assert set(runtime) < set(development) < set(benchmarks)
    for name in runtime:
        assert version(runtime[name]) == version(development[name])
    for name in development:
        assert version(development[name]) == version(benchmarks[name])


def test_the_build_needs_nothing_that_is_not_locked() -> None:
    """The project is built without an environment of its own, whose packages no hash would hold."""
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    assert {Requirement(text).name for text in build} <= set(locked("constraints.txt"))


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="runs make")
def test_the_bill_of_materials_lists_what_planrunner_runs_on(tmp_path: Path) -> None:
    """Installs the runtime by hash and lists it; the tool holds the result against the schema of CycloneDX."""
    if not (ROOT / ".venv" / ".ready").is_file():
        pytest.skip("needs the environment that make sets up")
    where = [f"BUILD={tmp_path}", f"DIST={tmp_path}", f"PYTHON={sys.executable}"]
    done = subprocess.run(["make", "sbom", *where], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    bill = json.loads((tmp_path / "planrunner.cdx.json").read_text(encoding="utf-8"))
    found = {canonicalize_name(item["name"]): item["version"] for item in bill["components"]}
    here = {
        name: version(pin)
        for name, pin in locked("constraints-runtime.txt").items()
        if not pin.marker or pin.marker.evaluate()
    }
    assert bill["bomFormat"] == "CycloneDX"
    assert found == here
    assert bill["metadata"]["component"]["name"] == PROJECT["name"]
    needs = {entry["ref"]: entry.get("dependsOn", []) for entry in bill["dependencies"]}
    assert len(needs[bill["metadata"]["component"]["bom-ref"]]) == len(RUNTIME)
    assert all(item.get("licenses") for item in bill["components"])
    assert str(ROOT) not in json.dumps(bill)
