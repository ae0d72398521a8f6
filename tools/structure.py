"""Counts that tell how easy the source is to carry on.

    python tools/structure.py [FOLDER]          # default: src/gcs_sysid

Files, lines, classes, functions, numeric constants of modules, modules that only one other module
imports, and in how many files one coefficient (`linear_drag`) is named. The generated dialect is
left out.
"""

import ast
import sys
from collections import Counter
from pathlib import Path

COEFFICIENT = "linear_drag"
GENERATED = ("gcs_sysid_dialect.py", "known_messages.py")


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


def imported(tree: ast.Module, package: str) -> set[str]:
    """Modules of a package that a module imports, as dotted names; some are names in them."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name.startswith(f"{package}.")}


def counts(folder: Path) -> dict[str, int]:
    """The counts by what they are of."""
    files = [f for f in sorted(folder.rglob("*.py")) if f.name not in GENERATED]
    total: Counter[str] = Counter(files=len(files))
    users: Counter[str] = Counter()
    modules = {
        ".".join(f.relative_to(folder.parent).with_suffix("").parts): f
        for f in files
        if f.stem not in ("__init__", "__main__")
    }
    for file in files:
        text = file.read_text(encoding="utf-8")
        tree = ast.parse(text)
        total["lines"] += text.count("\n")
        total[f"files that name {COEFFICIENT}"] += COEFFICIENT in text
        for node in ast.walk(tree):
            total["classes"] += isinstance(node, ast.ClassDef)
            total["functions"] += isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for statement in tree.body:
            if isinstance(statement, ast.Assign | ast.AnnAssign):
                total["numeric constants of modules"] += is_number(statement.value)
        users.update(imported(tree, folder.name) & modules.keys())
    total["modules with one importer"] = sum(users[name] == 1 for name in modules)
    return dict(total)


def main() -> None:
    """Print the counts."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "src/gcs_sysid")
    for what, count in counts(folder).items():
        print(f"{count:7d}  {what}")


if __name__ == "__main__":
    main()
