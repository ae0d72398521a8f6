"""Mutation tests: is there a test that fails when the code is wrong?

    python tools/mutate.py                              a sample of every module of the core
    python tools/mutate.py signals/smoothers.py --sample 0      all of one

A mutant changes one operator, number, condition, statement or result. It is compiled in memory and
loaded in a forked process, which runs the tests nearest to its module until one fails: the fast
ones, then the slow. Survivors that are known, each with a reason, stand in
tests/mutation_survivors.txt; others fail the run.

The constants of modules stay as they are: tests pin behavior, which few of them move alone.

Why our own: a process a mutant, as cosmic-ray has it, takes seconds to start; neither it nor mutmut
fails on new survivors only.
"""

import argparse
import ast
import contextlib
import importlib.util
import os
import random
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "gcs_sysid"
SURVIVORS = ROOT / "tests" / "mutation_survivors.txt"

CORE = {
    "estimation/rows": "actuator_dynamics regression",
    "estimation/noise": "uncertainty",
    "estimation/fit": "priors rotation search translation",
    "estimation/checks": "model_tests",
    "estimation/record": "input_noise",
    "estimation/changes": "flight_comparison sequential_tests",
    "estimation/parameters": "scale",
    "signals": "complementary flight_detection inertial_stream recursions smoothers stream_buffer",
    "telemetry": "clock decode messages",
}
ELSEWHERE = {
    "actuator_dynamics": ["commands", "online"],
    "clock": ["blocks", "intake"],
    "decode": ["blocks"],
    "inertial_stream": ["outliers"],
    "input_noise": ["commands", "online"],
    "messages": ["message_arrays"],
    "model_tests": ["rigid_body_test", "layout_test"],
    "regression": ["normal_equations", "online"],
    "rotation": ["rotation_elements", "priors", "commands", "online"],
    "scale": ["physical_parameters"],
    "search": ["rotation", "priors"],
    "smoothers": ["differentiator", "windows"],
    "stream_buffer": ["time_base"],
}
"""Where else than in tests/<room>/test_<module>.py the tests of a module are, nearest first."""

PYTEST = [
    "-x", "-q", "--assert=plain", "-p", "no:cacheprovider", "-p", "no:unraisableexception",
    "-p", "pytest_asyncio.plugin",
]  # fmt: skip
"""Without what takes longer than the tests: rewritten assertions, other plugins, collections."""
FAST, SLOW = ("-m", "not slow and not thorough"), ("-m", "slow and not thorough")
NO_TESTS = 5
"""pytest's exit status where none is selected."""

_OPERATORS: dict[type, tuple[type, ...]] = {
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,), ast.Mod: (ast.Mult,), ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd,), ast.BitXor: (ast.BitAnd,),
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.And: (ast.Or,), ast.Or: (ast.And,),
}  # fmt: skip


Place = tuple[ast.AST, str, int | None]
"""Node, field and index (None: the field is no list) of what is replaced."""


@dataclass(frozen=True)
class Mutant:
    """A module with one change."""

    key: str
    """What tells it from others of its module, whatever the line."""
    line: int
    tree: ast.Module
    """Of the whole module; the change is not in it yet."""
    place: Place
    new: Any

    def code(self, path: Path) -> Any:
        """The mutant, compiled."""
        with _replaced(*self.place, self.new):
            return compile(ast.fix_missing_locations(self.tree), str(path), "exec")


@contextlib.contextmanager
def _replaced(node: ast.AST, field: str, index: int | None, new: Any) -> Iterator[None]:
    holder, at = (vars(node), field) if index is None else (getattr(node, field), index)
    old, holder[at] = holder[at], new
    yield
    holder[at] = old


def mutants(source: str) -> list[Mutant]:
    """All mutants of a module."""
    tree = ast.parse(source)
    found: list[Mutant] = []
    seen: dict[str, int] = {}

    def add(scope: str, line: int, shown: ast.AST, place: Place, new: Any) -> None:
        before = ast.unparse(shown)
        with _replaced(*place, new):
            after = "pass" if isinstance(new, ast.Pass) else ast.unparse(shown)
        if after == before:  # of a default its function is not shown
            after = ast.unparse(new)
        key = f"{scope}: {' '.join(before.split())} -> {' '.join(after.split())}"
        seen[key] = seen.get(key, 0) + 1
        key += f" #{seen[key]}" if seen[key] > 1 else ""
        found.append(Mutant(key, line, tree, place, new))

    def visit(node: ast.AST, scope: str, around: ast.AST | None) -> None:
        """`around`: what is shown of a change, an expression or a statement."""
        for place, child in _children(node):
            inner, shown = scope, around
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                inner = child.name if scope == "module" else f"{scope}.{child.name}"
                shown = None
            elif isinstance(child, ast.expr | ast.stmt) and not isinstance(child, _ATOMS):
                shown = child
            if inner == "module" and isinstance(child, ast.Constant):
                continue  # tests pin behavior, not the constants of modules
            for new, at in _changes(child, place):
                line = getattr(child, "lineno", getattr(shown, "lineno", 0))
                add(inner, line, shown or child, at, new)
            visit(child, inner, shown)

    visit(tree, "module", None)
    return found


_ATOMS = (ast.Constant, ast.Name, ast.Tuple, ast.Slice, ast.UnaryOp, ast.Attribute)


def _children(node: ast.AST) -> Iterator[tuple[Place, ast.AST]]:
    """What may be mutated: no annotations, decorators, assertions, or messages of errors."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        many = value if isinstance(value, list) else [value]
        for i, child in enumerate(many):
            if isinstance(child, ast.AST) and not isinstance(child, ast.Assert | ast.Raise):
                yield (node, field, i if isinstance(value, list) else None), child


def _changes(node: ast.AST, place: Place) -> Iterator[tuple[Any, Place]]:
    """What a node may be replaced by, and where."""
    if isinstance(node, ast.operator | ast.cmpop | ast.boolop):
        for new in _OPERATORS.get(type(node), ()):
            yield new(), place
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        yield node.operand, place
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, bool):
            yield ast.Constant(not node.value), place
        elif isinstance(node.value, int):
            yield ast.Constant(node.value + 1), place
        elif isinstance(node.value, float):
            yield ast.Constant(2.0 * node.value if node.value else 1.0), place
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield ast.copy_location(ast.Pass(), node), place
    elif isinstance(node, ast.Return) and node.value is not None:
        if not (isinstance(node.value, ast.Constant) and node.value.value is None):
            yield ast.Constant(None), (node, "value", None)
    elif isinstance(node, ast.If | ast.While | ast.IfExp) and isinstance(
        node.test, ast.Name | ast.Attribute | ast.Call
    ):
        yield ast.UnaryOp(ast.Not(), node.test), (node, "test", None)


def nearest(module: str) -> list[str]:
    """The test files of a module."""
    room, *_, stem = module.removesuffix(".py").split("/")
    files = [f"tests/{room}/test_{name}.py" for name in (stem, *ELSEWHERE.get(stem, ()))]
    return [file for file in files if (ROOT / file).exists()]


def survives(
    module: str, code: Any, tests: Sequence[str], limit: float, which: Sequence[str] = FAST
) -> bool:
    """Whether all tests pass with this code in place of the module's, within `limit` s."""
    pid = os.fork()
    if not pid:
        status = 1
        try:
            signal.setitimer(signal.ITIMER_REAL, limit)  # ends the process
            for stream in (1, 2):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
            name = "gcs_sysid." + module.removesuffix(".py").replace("/", ".")
            if name in sys.modules:
                for other in [m for m in sys.modules if m.startswith(("gcs_sysid", "sim_bridge"))]:
                    del sys.modules[other]
            room = importlib.import_module(name.rpartition(".")[0])
            spec = importlib.util.spec_from_file_location(name, PACKAGE / module)
            sys.modules[name] = loaded = importlib.util.module_from_spec(spec)
            setattr(room, name.rpartition(".")[2], loaded)  # as an import does; tests patch by path
            exec(code, loaded.__dict__)
            import pytest

            status = int(pytest.main([*PYTEST, *which, *tests]))
            status = 0 if status == NO_TESTS else status
        finally:
            os._exit(status)
    return os.waitpid(pid, 0)[1] == 0


def known_survivors() -> dict[str, dict[str, str]]:
    """Module -> key of mutants -> why no test need fail; `...` in a key stands for anything."""
    known: dict[str, dict[str, str]] = {}
    table, key = {}, ""
    for line in SURVIVORS.read_text().splitlines() if SURVIVORS.exists() else []:
        if line.startswith("["):
            table = known.setdefault(line.strip("[] "), {})
        elif line.startswith(" "):
            table[key] = (table[key] + " " + line.strip()).strip()
        elif line and not line.startswith("#"):
            key = line.strip()
            table[key] = ""
    return known


def _matcher(pattern: str) -> Callable[[str], object]:
    return re.compile(re.escape(pattern).replace(r"\.\.\.", ".*")).fullmatch


def _warm_up() -> None:
    """Load what every test loads, and let Hypothesis draw the same each time and not shrink."""
    import hypothesis
    import numpy  # noqa: F401
    import pytest_asyncio  # noqa: F401
    import scipy.integrate
    import scipy.linalg
    import scipy.signal
    import scipy.spatial.transform  # noqa: F401

    import gcs_sysid.telemetry.intake  # noqa: F401
    import sim_bridge.cli  # noqa: F401

    phases = [hypothesis.Phase.explicit, hypothesis.Phase.generate]
    hypothesis.settings.register_profile(
        "mutate", database=None, deadline=None, derandomize=True, phases=phases
    )
    hypothesis.settings.load_profile("mutate")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; 1 if a mutant survived that is not known to."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "modules", nargs="*", help="such as signals/smoothers.py; default: the core"
    )
    parser.add_argument("--sample", type=int, default=20, help="mutants a module; 0: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--known", action="store_true", help="the known survivors alone")
    asked = parser.parse_args(arguments)
    sys.path[:0] = [str(ROOT / "src"), str(ROOT)]
    os.chdir(ROOT)
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:2])
    _warm_up()
    known, bad = known_survivors(), 0
    core = [f"{room}/{name}.py" for room, names in CORE.items() for name in names.split()]
    print(f"{'module':34}{'mutants':>8}{'tried':>7}{'killed':>8}{'known':>7}{'new':>5}{'s':>6}")
    for module in asked.modules or core:
        source, tests, began = (PACKAGE / module).read_text(), nearest(module), time.monotonic()
        limits = {}
        for which in (FAST, SLOW):
            started = time.monotonic()
            if not survives(module, compile(source, module, "exec"), tests, 600.0, which):
                print(f"{module}: its tests fail as it is: {' '.join(tests)}")
                return 2
            limits[which] = 5.0 + 3.0 * (time.monotonic() - started)
        own, every = known.get(module, {}), mutants(source)
        patterns = known.get("all modules", {}) | own
        fits = {p: {m.key for m in every if _matcher(p)(m.key)} for p in patterns}
        excused = set().union(*fits.values())
        draw = random.Random(f"{asked.seed} {module}")
        tried = draw.sample(every, min(asked.sample or len(every), len(every)))
        if asked.known:
            tried = [m for m in every if m.key in excused]
        run = [m for m in tried if asked.known or m.key not in excused]
        left = run
        for which, limit in limits.items():  # the slow tests see what the others let through
            left = [
                m for m in left if survives(module, m.code(PACKAGE / module), tests, limit, which)
            ]
        new = [m for m in left if m.key not in excused]
        killed, spared = len(run) - len(left), len(tried) - len(run) + len(left) - len(new)
        print(f"{module:34}{len(every):8}{len(tried):7}{killed:8}{spared:7}{len(new):5}"
              f"{time.monotonic() - began:6.0f}")  # fmt: skip
        wrong = [f"survived: src/gcs_sysid/{module}:{m.line} {m.key}" for m in new]
        wrong += [
            f"known to survive, but killed: {m.key}" for m in run if asked.known and m not in left
        ]
        wrong += [f"known to survive, but no mutant: {p}" for p in own if not fits[p]]
        wrong += [f"known to survive, but no reason: {p}" for p, why in patterns.items() if not why]
        for line in wrong:
            print(f"  {line}", flush=True)
        bad += len(wrong)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
