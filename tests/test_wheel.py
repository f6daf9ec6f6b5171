"""A wheel built from the tree, installed in a new environment in another folder, does the main job with what it ships."""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_wheel_in_a_new_environment(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", str(tmp_path / "dist"), str(ROOT)], check=True, capture_output=True)
    (wheel,) = (tmp_path / "dist").glob("planrunner-*.whl")
    venv.create(tmp_path / "env", with_pip=True)
    scripts = tmp_path / "env" / ("Scripts" if sys.platform == "win32" else "bin")
    install = [str(scripts / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    locked = ["--require-hashes", "--requirement", str(ROOT / "constraints-runtime.txt")]
    subprocess.run([*install, *locked], check=True, capture_output=True)
    subprocess.run([*install, "--no-deps", str(wheel)], check=True, capture_output=True)
    work = tmp_path / "elsewhere"
    work.mkdir()

    def planrunner(*arguments: str) -> str:
        command = [str(scripts / "planrunner"), *arguments]
        done = subprocess.run(
            command, cwd=work, capture_output=True, text=True, env={"PATH": "/usr/bin", "HOME": str(work)}
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert "flexure_gyro_eight_position" in planrunner("new")
    planrunner("new", "flexure_gyro_eight_position")
    header = (work / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8").splitlines()[0]
    assert (work / header.partition("$schema=")[2]).is_file()
    planrunner("check", "flexure_gyro_eight_position.yaml")
    out = planrunner("run", "flexure_gyro_eight_position.yaml", "--set", "device_serial=1", "--set", "operator=test")
    report = work / out.strip().splitlines()[-1]
    assert report.is_file()
    told = ["certificate_number", "customer", "customer_contact", "item_description", "issued_by"]
    given = [part for name in told for part in ("--set", f"{name}=x")]
    run = str(report.parents[2])
    page = planrunner("report", run, "certificate.zh.html", *given, "--set", "date_received=2026-01-01")
    assert "校准证书" in Path(work / page.strip()).read_text(encoding="utf-8")
    assert "17 of 17 comparisons passed" in planrunner("self-test")
    assert str(ROOT) not in report.read_text(encoding="utf-8")
