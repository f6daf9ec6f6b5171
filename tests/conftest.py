"""What all tests share: where real recordings lie, and a small plan to run."""

from __future__ import annotations

import atexit
import gc
import os
import pickle
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

# Two workers share two cores: threads of the linear algebra would only wait for each other. It reads this as it is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Tests start many processes: they compile the modules once, not each of them at every start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
import pytest
from hypothesis import HealthCheck, settings

# jsonschema would compile 39 grammars, 3 s in each process, for formats that no schema of ours uses: where the package that has them is
# installed (the tool behind `make sbom` needs it), jsonschema goes without it, as where it is absent.
sys.modules["rfc3987_syntax"] = None  # type: ignore[assignment]

# A shell starts background jobs with interruption ignored, and every process here would inherit that: tests interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The key by which a run folder is known again is the tests' own, in the processes that they start too.
os.environ["PLANRUNNER_STATE"] = tempfile.mkdtemp(prefix="planrunner-state-")
atexit.register(shutil.rmtree, os.environ["PLANRUNNER_STATE"], ignore_errors=True)

# How fast cases are drawn says how busy the machine is, not whether they pass.
settings.register_profile("planrunner", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("planrunner")
sys.dont_write_bytecode = False
# Circles are not searched for while modules are imported and tests are collected, and never among these afterwards; less often in the
# hundreds of megabytes of shared results.
gc.disable()
gc.set_threshold(20_000, 20, 20)

ROOT = Path(__file__).resolve().parents[1]
FLAGSHIP = ROOT / "plans" / "flexure_gyro_eight_position.yaml"
KEPT_OPEN = 8  # descriptors that libraries open once, and fixtures that the session shares
PAGE, NO_PAGE = "report: [report.html, summary.md]", "report: [summary.md]"


def pytest_collection_finish(session: pytest.Session) -> None:
    """What is there before the first test stays to the end."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder of real recordings; the test is skipped where there is none."""
    folder = Path(os.environ.get("PLANRUNNER_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "rimu_jig").is_dir():
        pytest.skip(f"no recordings beneath {folder}; set PLANRUNNER_DATA")
    return folder


@pytest.fixture(scope="session", autouse=True)
def pictures_are_drawn_once() -> Iterator[None]:
    """Many tests report the same run, and the same data give the same picture: a report that shows it again in this process takes it
    from the first. Tests of the drawing itself call what draws."""
    from planrunner.reporting import diagnosis_page
    from planrunner.reporting.view import Picture

    drawn: dict[bytes, str] = {}

    def once(draw: Callable[..., str], *data: object) -> str:
        key = pickle.dumps((draw.__qualname__, data))
        if key not in drawn:
            drawn[key] = draw(*data)
        return drawn[key]

    def shown(picture: Picture) -> str:
        draw = picture.draw
        return once(draw.func, *draw.args) if isinstance(draw, partial) else draw()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Picture, "__html__", shown)
        for name in ("heat_svg", "posterior_svg", "confusability_svg", "plot_svg"):
            patch.setattr(diagnosis_page, name, partial(once, getattr(diagnosis_page, name)))
        yield


@pytest.fixture(scope="module", autouse=True)
def descriptors_are_given_back() -> Iterator[None]:
    """No module leaves files, folders or sockets open: a process may hold 1024, and runs that go on for weeks are made by this code."""
    before = _descriptors()
    yield
    if _descriptors() > before + KEPT_OPEN:
        gc.collect()
    assert _descriptors() <= before + KEPT_OPEN, f"{_descriptors() - before} more are open than before this module"


def _descriptors() -> int:
    """How many file descriptors this process holds; 0 on systems that do not list them."""
    for folder in ("/proc/self/fd", "/dev/fd"):
        if os.path.isdir(folder):
            return len(os.listdir(folder))
    return 0


@pytest.fixture
def plan_file(tmp_path: Path) -> Callable[..., Path]:
    """The flagship plan with texts replaced, as a file of its own. It asks for no page, whose pictures take longer than the run."""

    def write(*replacements: tuple[str, str], name: str = "plan.yaml") -> Path:
        text = FLAGSHIP.read_text(encoding="utf-8").replace(PAGE, NO_PAGE)
        for old, new in replacements:
            assert old in text, f"the flagship plan has no {old!r}"
            text = text.replace(old, new)
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write
