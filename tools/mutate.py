"""Mutation tests: is there a test that fails when the code is wrong?

    python tools/mutate.py                              a sample of every module of the core
    python tools/mutate.py signals/windows.py --sample 0      all of one

A mutant changes one operator, number, condition, statement or result. It is compiled in memory and
loaded in a forked process, which runs the tests nearest to its module until one fails. Survivors
that are known, each with a reason, stand in tests/mutation_survivors.txt; others fail the run.

Why our own: mutmut mutates functions alone, and most thresholds here are constants of modules; a
process a mutant, as cosmic-ray has it, takes seconds to start. Neither fails on new survivors only.
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
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "gcs_sysid"
SURVIVORS = ROOT / "tests" / "mutation_survivors.txt"

NEAREST: dict[str, str] = {
    "estimation/actuator_dynamics.py": "",
    "estimation/command_noise.py": "test_input_noise test_commands",
    "estimation/flight_comparison.py": "",
    "estimation/normal_equations.py": "",
    "estimation/priors.py": "",
    "estimation/rigid_body_test.py": "",
    "estimation/rotation.py": "test_priors",
    "estimation/scale.py": "test_physical_parameters",
    "estimation/search.py": "test_rotation test_priors",
    "estimation/sequential_tests.py": "",
    "estimation/speed_noise.py": "test_input_noise",
    "estimation/translation.py": "",
    "estimation/uncertainty.py": "",
    "signals/complementary.py": "",
    "signals/differentiator.py": "",
    "signals/flight_detection.py": "",
    "signals/outliers.py": "",
    "signals/recursions.py": "",
    "signals/smoothers.py": "",
    "signals/stream_buffer.py": "test_time_base",
    "signals/windows.py": "",
    "telemetry/block_decode.py": "test_blocks test_decode",
    "telemetry/clock.py": "",
    "telemetry/decode.py": "test_blocks",
    "telemetry/messages.py": "",
}
"""The core, and where else than in tests/<room>/test_<module>.py its tests are, nearest first."""

PYTEST = [
    "-x", "-q", "--assert=plain", "-p", "no:cacheprovider", "-p", "no:unraisableexception",
    "-p", "pytest_asyncio.plugin", "-m", "not slow and not thorough",
]  # fmt: skip
"""Without what takes longer than the tests: rewritten assertions, other plugins, collections."""

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
    """A module with one change.

    Attributes:
        key: what tells it from others of its module, whatever the line.
        line: where it is.
        tree: of the whole module; the change is not in it yet.
        place: of what is replaced.
        new: what replaces it.
    """

    key: str
    line: int
    tree: ast.Module
    place: Place
    new: Any

    def code(self, path: Path) -> Any:
        """The mutant, compiled."""
        with _replaced(*self.place, self.new):
            return compile(ast.fix_missing_locations(self.tree), str(path), "exec")


@contextlib.contextmanager
def _replaced(node: ast.AST, field: str, index: int | None, new: Any) -> Iterator[None]:
    old = getattr(node, field)
    if index is None:
        setattr(node, field, new)
    else:
        old = old[index]
        getattr(node, field)[index] = new
    yield
    if index is None:
        setattr(node, field, old)
    else:
        getattr(node, field)[index] = old


def mutants(source: str) -> list[Mutant]:
    """All mutants of a module."""
    tree = ast.parse(source)
    found: list[Mutant] = []
    seen: dict[str, int] = {}

    def add(scope: str, line: int, shown: ast.AST, place: Place, new: Any) -> None:
        before = ast.unparse(shown)
        with _replaced(*place, new):
            after = "pass" if isinstance(new, ast.Pass) else ast.unparse(shown)
        key = f"{scope}: {' '.join(before.split())} -> {' '.join(after.split())}"
        seen[key] = seen.get(key, 0) + 1
        key += f" #{seen[key]}" if seen[key] > 1 else ""
        found.append(Mutant(key, line, tree, place, new))

    def visit(node: ast.AST, scope: str, around: ast.AST) -> None:
        """`around`: what is shown of a change, an expression or a statement."""
        for place, child in _children(node):
            inner, shown = scope, around
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                inner = child.name if scope == "module" else f"{scope}.{child.name}"
                shown = child.args if isinstance(child, ast.FunctionDef) else child
            elif isinstance(child, ast.expr | ast.stmt) and not isinstance(child, _ATOMS):
                shown = child
            for new, at in _changes(child, place):
                line = getattr(child, "lineno", getattr(shown, "lineno", 0))
                add(inner, line, shown, at, new)
            visit(child, inner, shown)

    visit(tree, "module", tree)
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


class _Swap:
    """Loads a mutant in place of its module."""

    def __init__(self, name: str, path: Path, code: Any) -> None:
        self.name, self.path, self.code = name, path, code

    def find_spec(self, name: str, path: object = None, target: object = None) -> Any:
        if name == self.name:
            return importlib.util.spec_from_file_location(name, self.path, loader=self)  # type: ignore[arg-type]
        return None

    def create_module(self, spec: object) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        exec(self.code, module.__dict__)


def nearest(module: str) -> list[str]:
    """The test files of a module."""
    room, stem = module.removesuffix(".py").split("/")
    names = [f"test_{stem}", *NEAREST.get(module, "").split()]
    files = [f"tests/{room}/{name}.py" for name in dict.fromkeys(names)]
    return [file for file in files if (ROOT / file).exists()]


def survives(module: str, code: Any, tests: Sequence[str], limit: float) -> bool:
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
                for loaded in [m for m in sys.modules if m.startswith(("gcs_sysid", "sim_bridge"))]:
                    del sys.modules[loaded]
            sys.meta_path.insert(0, _Swap(name, PACKAGE / module, code))  # type: ignore[arg-type]
            import pytest

            status = int(pytest.main([*PYTEST, *tests]))
        finally:
            os._exit(status)
    return os.waitpid(pid, 0)[1] == 0


def known_survivors() -> dict[str, dict[str, str]]:
    """Module -> key of a mutant -> why no test need fail; `...` in a key stands for anything."""
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
    parser.add_argument("modules", nargs="*", help="such as signals/windows.py; default: the core")
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
    print(f"{'module':34}{'mutants':>8}{'tried':>7}{'killed':>8}{'known':>7}{'new':>5}{'s':>6}")
    for module in asked.modules or NEAREST:
        source = (PACKAGE / module).read_text()
        every, tests, began = mutants(source), nearest(module), time.monotonic()
        if not survives(module, compile(source, module, "exec"), tests, 600.0):
            print(f"{module}: its tests fail as it is: {' '.join(tests)}")
            return 2
        limit = 5.0 + 3.0 * (time.monotonic() - began)
        reasons = {pattern: _matcher(pattern) for pattern in known.get(module, {})}
        excused = [m for m in every if any(fits(m.key) for fits in reasons.values())]
        tried = every if not asked.sample else random.Random(f"{asked.seed} {module}").sample(
            every, min(asked.sample, len(every))
        )  # fmt: skip
        tried = excused if asked.known else tried
        run = [m for m in tried if asked.known or m not in excused]
        left = [m for m in run if survives(module, m.code(PACKAGE / module), tests, limit)]
        new = [m for m in left if m not in excused]
        spared, seconds = len(tried) - len(run) + len(left) - len(new), time.monotonic() - began
        killed = len(run) - len(left)
        print(f"{module:34}{len(every):8}{len(tried):7}{killed:8}{spared:7}{len(new):5}"
              f"{seconds:6.0f}", flush=True)  # fmt: skip
        for mutant in new:
            print(f"  survived: src/gcs_sysid/{module}:{mutant.line} {mutant.key}", flush=True)
        for mutant in (m for m in run if asked.known and m not in left):
            print(f"  killed by now: {mutant.key}")
        stale = [p for p, fits in reasons.items() if not any(fits(m.key) for m in every)]
        for pattern in stale:
            print(f"  in {SURVIVORS.name}, but no mutant: {pattern}")
        bad += len(new) + len(stale)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
