"""Counts that show how easy the source is to carry on.

python tools/structure.py            # the table, each count beside its bar
python tools/structure.py --names    # also what stands behind counts of names and circles
"""

import argparse
import ast
from collections import Counter, defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "gcs_sysid"
JUDGED = ("Estimate", "IdentifiedEstimate", "KnownEstimate", "Result", "Health", "Inspection")
"""Classes with a status, a verdict or reasons."""
WORDS = {
    "status": {"identified", "given", "zero", "weak", "unobservable"},
    "verdict": {"identified", "partial", "refused", "available", "yes", "partly", "no"},
}
"""What is decided in one room."""
BARS = {
    "writers of a status or verdict": 1,
    "lines": 58_000,
    "files": 280,
    "lines of estimation": 11_500,
    "lines of benchmarks": 9_000,
    "lines of tests": 44_000,
    "numeric constants of modules": 500,
    "modules with one importer": 50,
    "import circles": 0,
    "class names with two meanings": 0,
    "definitions of take": 8,
}
"""What each count may be at most."""


def parsed(folder: Path) -> dict[str, ast.Module]:
    """The modules below a folder, by dotted name."""
    return {
        ".".join(file.relative_to(folder.parent).with_suffix("").parts): ast.parse(
            file.read_text(encoding="utf-8")
        )
        for file in sorted(folder.rglob("*.py"))
    }


def lines(folder: Path) -> int:
    """Lines of Python below a folder."""
    files = folder.rglob("*.py")
    return sum(file.read_text(encoding="utf-8").count("\n") for file in files)


def is_number(node: ast.expr | None) -> bool:
    """Whether an expression is a number, or numbers in a tuple, signs and arithmetic included."""
    match node:
        case ast.Constant(value=bool() | str() | None):
            return False
        case ast.Constant():
            return True
        case ast.UnaryOp(operand=operand):
            return is_number(operand)
        case ast.BinOp(left=left, right=right):
            return is_number(left) and is_number(right)
        case ast.Tuple(elts=items):
            return bool(items) and all(map(is_number, items))
    return False


def imported(tree: ast.Module, modules: set[str]) -> set[str]:
    """Those of some modules that a module imports, wherever in it."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found & modules


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other, directly or through others of the group."""
    reached: dict[str, set[str]] = {}
    for start in imports:
        seen: set[str] = set()
        waiting = list(imports[start])
        while waiting:
            if (name := waiting.pop()) not in seen:
                seen.add(name)
                waiting += imports[name]
        reached[start] = seen
    groups = {
        frozenset(other for other in reached[name] if name in reached[other])
        for name in imports
        if name in reached[name]
    }
    return sorted(sorted(group) for group in groups)


def is_read(value: ast.expr, name: str) -> bool:
    """Whether a value is handed on from an attribute, or an entry of a file, of that name."""
    return any(
        (isinstance(node, ast.Attribute) and node.attr == name)
        or (isinstance(node, ast.Constant) and node.value == name)
        for node in ast.walk(value)
    )


def judgements(tree: ast.Module) -> list[int]:
    """Lines on which a module makes a status, a verdict or its reasons.

    Those are arguments of what is judged, or of `replace`, that are not read elsewhere; and their
    words where they are returned or chosen between. An `Objection` only asks for one.
    """
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            called = node.func.id if isinstance(node.func, ast.Name) else called
            made = {keyword.arg: keyword.value for keyword in node.keywords if keyword.arg}
            if called in JUDGED:
                names = ("status", "verdict", "reasons")
                if called.endswith("Estimate") and len(node.args) > 3:
                    made["status"] = node.args[3]
                found += [node.lineno for n in names if n in made and not is_read(made[n], n)]
            elif called == "replace":
                found += [
                    node.lineno
                    for name, words in WORDS.items()
                    for part in ast.walk(made.get(name, ast.Pass()))
                    if isinstance(part, ast.Constant) and part.value in words
                ]
                found += [node.lineno for name in ("reasons",) if name in made]
    return found


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--names", action="store_true", help="what stands behind the counts")
    names = parser.parse_args().names
    trees = parsed(SOURCE)
    imports = {
        name: imported(tree, trees.keys() - {name})
        for name, tree in trees.items()
        if not name.endswith("__init__")
    }
    importers: defaultdict[str, list[str]] = defaultdict(list)
    for name, others in imports.items():
        for other in others:
            importers[other].append(name)
    classes: defaultdict[str, set[str]] = defaultdict(set)
    functions: Counter[str] = Counter()
    numbers = 0
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                classes[node.name.strip("_")].add(name)
            elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                functions[node.name] += 1
        assigned = (s for s in tree.body if isinstance(s, ast.Assign | ast.AnnAssign))
        numbers += sum(is_number(statement.value) for statement in assigned)
    loops = circles({name: others & imports.keys() for name, others in imports.items()})
    twice = {name: sorted(where) for name, where in classes.items() if len(where) > 1}
    single = {
        name: importers[name][0]
        for name in imports
        if len(importers[name]) == 1 and not name.endswith("__main__")
    }
    writers = {name: found for name, tree in trees.items() if (found := judgements(tree))}
    rooms = {".".join(name.split(".")[:2]) for name in writers}
    counts = {
        "writers of a status or verdict": len(rooms),
        "lines": lines(SOURCE),
        "files": len(trees),
        "lines of estimation": lines(SOURCE / "estimation"),
        "lines of benchmarks": lines(ROOT / "benchmarks"),
        "lines of tests": lines(ROOT / "tests"),
        "numeric constants of modules": numbers,
        "modules with one importer": len(single),
        "import circles": len(loops),
        "class names with two meanings": len(twice),
        "definitions of take": functions["take"],
    }
    for what, count in counts.items():
        print(f"{count:7d}  {what:32s} at most {BARS[what]}")
    if names:
        print("", *(" <-> ".join(loop) for loop in loops), sep="\n")
        print(
            "", *(f"{name}: {', '.join(where)}" for name, where in sorted(twice.items())), sep="\n"
        )
        print("", *(f"{name}: judges on line {lines}" for name, lines in writers.items()), sep="\n")
        print("", *(f"{name} <- {by}" for name, by in sorted(single.items())), sep="\n")


if __name__ == "__main__":
    main()
