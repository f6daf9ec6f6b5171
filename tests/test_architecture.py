"""The rooms of the house: who may import whom, that nothing goes in circles, and what `check` may cost."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "planrunner"
ENTRY = {"planrunner", "planrunner.__main__"}
"""The two modules that stand at the door."""


@cache
def rooms() -> tuple[str, ...]:
    """The rooms from the roof to the ground, as the table in CONTRIBUTING.md lists them."""
    return tuple(re.findall(r"^\| `(\w+)/` \|", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.MULTILINE))


@cache
def modules() -> dict[str, Path]:
    """Every module of the package by its name; a package goes by its own."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        found[name.removesuffix(".__init__")] = path
    return found


@cache
def graph() -> dict[str, frozenset[str]]:
    """Module → the modules of ours that it imports anywhere, inside functions and for types alone too."""
    return {name: frozenset(imported(path) - {name}) for name, path in modules().items()}


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """Everything in a module's syntax, the module itself first: parsed once for all tests of this file."""
    return tuple(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@pytest.fixture(scope="module", autouse=True)
def nodes_are_forgotten() -> Iterator[None]:
    """A million nodes would slow down the tests that follow in this process."""
    yield
    nodes.cache_clear()


def imported(path: Path) -> set[str]:
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & modules().keys()
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path} imports relative to itself"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found |= {whole if whole in modules() else str(node.module)} & modules().keys()
    return found


def room_of(module: str) -> str:
    return module.split(".")[1]


def circles(edges: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """The strongly connected components of more than one node (Tarjan, Depth-first search and linear graph algorithms, 1972)."""
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(node: str) -> None:
        order[node] = lowest[node] = len(order)
        stack.append(node)
        for other in edges.get(node, ()):
            if other not in order:
                visit(other)
            if other in stack:
                lowest[node] = min(lowest[node], lowest[other])
        if lowest[node] == order[node]:
            component = [stack.pop()]
            while component[-1] != node:
                component.append(stack.pop())
            if len(component) > 1:
                found.append(sorted(component))

    for node in edges:
        if node not in order:
            visit(node)
    return found


def test_the_table_names_every_room_once() -> None:
    assert sorted(rooms()) == sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))


def test_no_module_lies_loose_beside_the_rooms() -> None:
    assert {f"planrunner.{path.stem}" for path in PACKAGE.glob("*.py")} == {
        "planrunner.__init__",
        "planrunner.__main__",
    }


@pytest.mark.parametrize(
    ("path", "more"),
    [("dwell", "the file of each instrument, the file of the estimator"), ("diagnosis", "the effects")],
)
def test_the_files_of_a_path_exist_and_are_counted(path: str, more: str) -> None:
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split(f"## The path of a {path}\n")[1]
    section = section.split("\n## ")[0]
    stated = re.search(r"these (\d+) files", section)
    folder, listed = "", set()
    for named, file in re.findall(r"`([\w/]+/)`|`([\w/]+\.py)`", section.split("\n1. ", 1)[1]):
        folder = named or folder
        if file:
            listed.add(file if "/" in file else f"{folder}{file}")
    assert [file for file in sorted(listed) if not (PACKAGE / file).is_file()] == []
    assert stated is not None and int(stated[1]) == len(listed) + len(more.split(", "))


@pytest.mark.parametrize("room", rooms())
def test_imports_point_down_the_list(room: str) -> None:
    below = set(rooms()[rooms().index(room) :])
    for module in modules().keys() - ENTRY:
        if room_of(module) == room:
            upward = {other for other in graph()[module] - {"planrunner"} if room_of(other) not in below}
            assert not upward, f"{module} imports {sorted(upward)}"


def test_no_modules_import_one_another_in_a_circle() -> None:
    assert circles(graph()) == []


def test_a_circle_is_found() -> None:
    assert circles({"a": ["b"], "b": ["c", "d"], "c": ["a"], "d": []}) == [["a", "b", "c"]]


def test_folders_within_rooms_form_no_circle() -> None:
    """Such as `gap/evidence`, `gap/hypotheses` and `gap/answer`."""

    def folder(module: str) -> str:
        return module if modules()[module].name == "__init__.py" else module.rpartition(".")[0]

    edges: dict[str, set[str]] = {folder(module): set() for module in modules()}
    for module, others in graph().items():
        for here, there in ((folder(module), folder(other)) for other in others):
            if not f"{here}.".startswith(f"{there}.") and not f"{there}.".startswith(f"{here}."):
                edges[here].add(there)
    assert circles(edges) == []


FACADES = {"planrunner.estimators.interface": "all that the author of an estimator needs, also for plug-ins"}
"""Modules from which names of other modules are imported, and why."""


def defined(path: Path) -> set[str]:
    """The names that a module defines itself, at any place."""
    found = {node.id for node in nodes(path) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return found | {node.name for node in nodes(path) if isinstance(node, ast.FunctionDef | ast.ClassDef)}


def test_names_are_imported_from_the_module_that_defines_them() -> None:
    """A module that passes a name on is a detour for everybody who looks for its definition."""
    passed_on = {
        f"{module} imports {alias.name} from {node.module}"
        for module, path in modules().items()
        for node in nodes(path)
        if isinstance(node, ast.ImportFrom) and node.module in modules().keys() - FACADES
        for alias in node.names
        if f"{node.module}.{alias.name}" not in modules() and alias.name not in defined(modules()[str(node.module)])
    }
    assert passed_on == set()


def docstrings(path: Path) -> Iterator[str]:
    for node in nodes(path):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield ast.get_docstring(node) or ""


def test_modules_that_docstrings_mention_exist() -> None:
    """`planrunner.plan.units`, `plan.units` and what stands after them, wherever docstrings and docs name them."""
    named = rf"(?:planrunner\.)?(?:{'|'.join(rooms())})(?:\.\w+)+"
    texts = [(path, text) for path in modules().values() for text in docstrings(path)]
    texts += [(path, path.read_text(encoding="utf-8")) for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]]
    missing = [
        f"{path.relative_to(ROOT)}: {mention}"
        for path, text in texts
        if path.name != "CHANGELOG.md"
        for mention in re.findall(rf"(?<=`)({named})(?=`)|(?<![\w.`/])(planrunner\.\w+(?:\.\w+)+)", text)
        for mention in mention
        if mention and not exists(mention)
    ]
    assert missing == []


def exists(mention: str) -> bool:
    """Whether a dotted name is a module or something in one; file names such as `plan.yaml` and entry-point groups pass."""
    words = mention.removeprefix("planrunner.").split(".")
    if words[-1] in ("yaml", "json", "jsonl"):
        return True
    for count in range(len(words), 0, -1):
        module = ".".join(["planrunner", *words[:count]])
        if module in modules():
            rest = words[count:]
            return not rest or (
                count > 1 and re.search(rf"\b{rest[0]}\b", modules()[module].read_text(encoding="utf-8")) is not None
            )
    return False


def test_names_in_module_docstrings_exist() -> None:
    """A module that was renamed goes on being named in the docstrings of others: each name there has to be found in the code."""
    words: set[str] = set()
    for path in modules().values():
        words |= set(path.relative_to(ROOT).with_suffix("").parts)
        for node in nodes(path):
            words |= {
                value for field in ("id", "attr", "arg", "name") if isinstance(value := getattr(node, field, None), str)
            }
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and "`" not in node.value:
                words |= set(re.findall(r"\w+", node.value))
    missing = []
    for module, path in modules().items():
        text = next(docstrings(path))
        missing += [f"{module}: {name}" for name in re.findall(r"`([a-z]+(?:_[a-z]+)+)`", text) if name not in words]
    assert missing == []


def test_nothing_but_the_entry_point_imports_the_command_line() -> None:
    for module, others in graph().items():
        if module != "planrunner.__main__" and room_of(f"{module}.") != "cli":
            assert not {other for other in others if other.startswith("planrunner.cli")}, module


def test_simulator_and_estimators_share_no_formula() -> None:
    """The simulated world states the physics of its sensors itself: a mistake that estimators shared with it could not be seen."""
    formulas = {"planrunner.error_model.terms", "planrunner.error_model.flexure_gyro", "planrunner.error_model.effects"}
    for module, others in graph().items():
        if room_of(f"{module}.") in ("instruments", "simulators"):
            assert not {other for other in others if any(other.startswith(one) for one in formulas)}, module


REAL = ("wire", "sensors", "tables", "chambers")


def test_simulated_instruments_and_drivers_share_no_code() -> None:
    """Each is written from the protocols alone, so that a shared misunderstanding cannot hide."""
    drivers = {f"planrunner.instruments.{folder}" for folder in REAL}
    simulators = [module for module in modules() if module.startswith("planrunner.simulators")]
    assert len(simulators) > 1
    for module in simulators:
        assert not {other for other in graph()[module] if other.startswith(tuple(drivers))}, module
    for module in modules():
        if module.startswith(tuple(drivers)):
            assert "planrunner.simulators" not in modules()[module].read_text(encoding="utf-8"), module


HEAVY = (
    "GTC",
    "babel",
    "jinja2",
    "jsonschema",
    "markupsafe",
    "matplotlib",
    "numba",
    "numpy.random",
    "pint",
    "planrunner.estimators.analysis",
    "planrunner.observation.screening",
    "pyarrow",
    "pyvisa",
    "rich",
    "scipy",
    "serial",
)


def test_check_of_the_shipped_plans_imports_nothing_heavy() -> None:
    code = (
        "import sys; from planrunner.cli import main;"
        "[main(['check', plan]) or print('HELD', plan, sorted({*HEAVY} & set(sys.modules))) for plan in sys.argv[1:]]"
    ).replace("HEAVY", repr(HEAVY))
    plans = sorted(str(path) for path in (ROOT / "plans").glob("*.yaml"))
    run = subprocess.run([sys.executable, "-c", code, *plans], capture_output=True, text=True, check=True)
    held = [line for line in run.stdout.splitlines() if line.startswith("HELD ")]
    assert held == [f"HELD {plan} []" for plan in plans]


def test_check_of_positions_at_rest_imports_no_masked_arrays() -> None:
    """`np.median` and `np.unique` import them, which takes as long as checking five plans."""
    code = "import sys; from planrunner.cli import main; sys.exit(main(['check', sys.argv[1]]) or 'numpy.ma' in sys.modules)"
    plan = str(ROOT / "plans" / "flexure_gyro_eight_position.yaml")
    subprocess.run([sys.executable, "-c", code, plan], capture_output=True, check=True)


OPENERS = {
    "base/regular_files.py": "every file that somebody else named",
    "base/guarded_folder.py": "everything in a run folder",
    "base/exclusive.py": "locks",
    "base/shipped.py": "shipped pages",
    "base/cluster.py": "its own source",
    "bench/lock.py": "the folder of locks",
    "cli/__init__.py": "the null device, when standard output went away",
    "cli/new.py": "shipped plans, copied",
    "cli/printing.py": "files that it makes new",
    "cli/simulate_bench.py": "the file that says where everything listens, made new",
    "archive/formats.py": "shipped schemas",
    "reporting/language.py": "shipped catalogues",
    "tasks/diagnose.py": "shipped benches",
    "tasks/self_test.py": "its own reference data",
    "signing/keys.py": "private keys that it makes new, readable by their owner only",
}
"""Modules that open files by the means of Python, and what they open."""


def test_files_that_somebody_named_are_opened_in_one_place() -> None:
    """A pipe as a plan would hang the program, and a device would fill its memory, where a file is simply opened."""
    reading = {"read_text", "read_bytes", "memory_map", "read_table", "OSFile"}
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in nodes(path):
            if not isinstance(node, ast.Call):
                continue
            whole = ast.unparse(node.func)
            by_path = isinstance(node.func, ast.Attribute) and node.func.attr in reading
            ours = whole.startswith(("source.", "resource.", "self.resource."))  # the one place, and a port
            opened = whole in ("open", "io.open", "os.open", "FileIO", "os.fdopen") or (
                isinstance(node.func, ast.Attribute) and node.func.attr == "open" and bool(node.args)
                and isinstance(node.args[0], ast.Constant)
            )  # fmt: skip
            if opened or (by_path and not ours):
                found.add(path.relative_to(PACKAGE).as_posix())
    assert found == set(OPENERS)


DEVICES = ("planrunner.instruments.tables", "planrunner.instruments.chambers", "planrunner.instruments.sensors")
"""A simulated device has the name of the device: the driver's class and the simulator's are one thing seen from both ends of a line."""


def named_in_public(path: Path) -> Iterator[tuple[str, str]]:
    """Public classes and aliases of types at the top of a module, each with what it means: an alias means what it stands for."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, f"class in {path}"
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if name[0].isupper() and not name.isupper():
                yield name, ast.unparse(node.value)


def test_public_names_of_types_have_one_meaning() -> None:
    meanings: dict[str, dict[str, str]] = {}
    for module, path in modules().items():
        for name, meaning in named_in_public(path):
            meanings.setdefault(name, {})[meaning] = module
    twice = {}
    for name, found in meanings.items():
        rooms_of_it = sorted(found.values())
        device = len(found) == 2 and rooms_of_it[0].startswith(DEVICES) and room_of(rooms_of_it[1]) == "simulators"
        if len(found) > 1 and not device:
            twice[name] = rooms_of_it
    assert twice == {}, "give each its own name, in the words of its field"


MODULES = {"os", "signal", "yaml"}
"""Modules that lack some of their constants on some platforms."""
PROBES = {
    ("archive/journal.py", "tolist"): "arrays and NumPy scalars become JSON, without NumPy being imported",
    ("base/dataclass.py", "__post_init__"): "the language's own hook",
    ("base/guarded_folder.py", "st_file_attributes"): "a field that only Windows has",
    ("base/trusted_folders.py", "st_file_attributes"): "a field that only Windows has",
    ("instruments/wire/serial_stream.py", "set_buffer_size"): "a method that only Windows' ports have",
    ("reporting/templates.py", "__html__"): "the convention by which text is marked as HTML",
}
"""Attributes whose presence is asked for by name, and why no type can promise them."""


def probes(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("getattr", "hasattr"):
            whose, name = node.args[:2]
            platform = isinstance(whose, ast.Name) and whose.id.lstrip("_") in MODULES
            if isinstance(name, ast.Constant) and not platform:
                yield str(name.value)


def test_nothing_asks_an_object_for_an_attribute_that_its_type_could_promise() -> None:
    """A protocol or a typed attribute with a default says what an object can do; a name in quotes escapes every check."""
    found = {(path.relative_to(PACKAGE).as_posix(), name) for path in PACKAGE.rglob("*.py") for name in probes(path)}
    assert found == set(PROBES)


READS_NAMES = {
    "planrunner.estimators.tilted.mounted_axes": "the name of an output ends with its axis in the plan's `mounting`"
}
"""Modules of the numerical rooms that look at the beginning or end of a name, with the reason."""


@pytest.mark.parametrize(
    "room", ["estimators", "gap", "error_model", "observation", "design", "uncertainty", "physics"]
)
def test_the_beginning_or_end_of_a_name_decides_nothing(room: str) -> None:
    """A role is a field or an enumeration, not a prefix of a name, a title or a sentence."""
    found = {
        name
        for name, path in modules().items()
        if name.startswith(f"planrunner.{room}.")
        for node in nodes(path)
        if isinstance(node, ast.Attribute) and node.attr in ("startswith", "endswith")
    }
    assert found == {name for name in READS_NAMES if name.startswith(f"planrunner.{room}.")}


ANYTHING = {
    "base/compiled.py": (9, "numba's decorator gives back the function that it is given"),
    "base/dataclass.py": (
        37,
        "writes the methods of classes of any kind, as the decorator of the standard library does",
    ),
    "base/documents.py": (1, "`Json`: a value of a document, which a schema and the code that reads it check"),
    "base/plugins.py": (1, "what an entry point holds: the caller states the type that its group promises"),
    "error_model/added.py": (1, "the same arrays of a record, put in by name"),
    "estimators/rocking/parameters.py": (2, "a declared key: the annotation of its field is its type"),
    "gap/answer/next.py": (1, "the same arrays of a record, put in by name"),
    "instruments/virtual/ellipsoid.py": (9, "a number or an array, as numpy's own functions take and give"),
    "instruments/virtual/inertial_axis.py": (2, "a key of an axis or of its group, by name"),
    "instruments/wire/links.py": (1, "PyVISA's manager, which gives resources of the kind that an address names"),
    "plan/expand.py": (1, "the values of a state, by its keys, until they are one record"),
    "plan/kinds.py": (22, "a declared key: the annotation of its field is its type"),
    "plan/units.py": (2, "pint's registry, whose numbers are of all kinds"),
    "reporting/sandbox.py": (10, "what the expressions of a template handle"),
}
"""Modules that say `Any`, how often, and why. Fewer are better: lower the number with them."""


def test_what_may_be_anything_is_listed_with_its_reason() -> None:
    """At a wall, `Any` switches the check off for both sides: a protocol, a type variable, `object` or `Json` says more."""
    found = {
        path.relative_to(PACKAGE).as_posix(): count
        for path in PACKAGE.rglob("*.py")
        if (count := sum(isinstance(node, ast.Name) and node.id == "Any" for node in nodes(path)))
    }
    assert found == {name: count for name, (count, _) in ANYTHING.items()}
