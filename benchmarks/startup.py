"""How long every command takes to start: `make startup`.

    python -m benchmarks.startup [--runs 5] [--sizes]

Prints a row for each command: processor time of `COMMAND --help`, and of loading all that the
command needs before it looks at its input, the least of several runs; what the latter has loaded of
the heavy packages; and its ratio to Python with NumPy alone, which means the same on any machine.
--sizes: what the dependencies take on disk, with the screen and without. Not on Windows.
"""

import re
import sys
import tomllib
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from gcs_sysid.cli.commands import COMMANDS
from testbed.study import PROJECT, arguments, markdown, run

SCREEN = ("textual", "textual-serve", "aiohttp")
HEAVY = ("numpy", "scipy", "pymavlink", "textual", "aiohttp", "rich", "serial", "asyncio",
         "multiprocessing", "pyarrow", "distributed")  # fmt: skip
_SHOW = "import sys; print(*(n for n in {heavy} if n in sys.modules))"


def cost(code: str, runs: int) -> tuple[float, str]:
    """Least processor time of a program in s, user and system; and what it prints."""
    best = min((run(("-c", code)) for _ in range(runs)), key=lambda done: done.seconds)
    if best.status:
        sys.exit(best.said)
    return best.seconds, best.told.strip()


def needed(roots: Sequence[str]) -> dict[str, int]:
    """Installed project -> bytes on disk, of some projects and all that they depend on."""
    found: dict[str, int] = {}
    todo = list(roots)
    while todo:
        name = re.sub(r"[-_.]+", "-", todo.pop()).lower()
        if name in found:
            continue
        try:
            there = distribution(name)
        except PackageNotFoundError:
            continue  # a system's or a Python's that is not this one
        files = (Path(str(there.locate_file(f))) for f in there.files or ())
        found[name] = sum(f.stat().st_size for f in files if f.is_file() and f.suffix != ".pyc")
        for line in there.requires or ():
            if "extra ==" not in line:
                todo.append(re.match(r"[\w.-]+", line)[0])  # type: ignore[index]
    return found


def sizes() -> list[str]:
    """What is installed for the program, and what of it for the screen alone."""
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.match(r"[\w.-]+", line)[0] for line in project["dependencies"]]  # type: ignore[index]
    core = needed([name for name in names if name not in SCREEN])
    alone = {n: size for n, size in needed(SCREEN).items() if n not in core}
    whole, part = sum(core.values()), sum(alone.values())
    return [
        f"dependencies: {(whole + part) / 1e6:.0f} MB",
        f"of them for screen and browser alone: {part / 1e6:.0f} MB, {part / (whole + part):.0%} "
        f"({', '.join(sorted(alone, key=lambda n: -alone[n]))})",
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table, or the reasons."""
    parser = arguments(__doc__)
    names = [command.name for command in COMMANDS]
    parser.add_argument("--runs", type=int, default=5, metavar="N")
    parser.add_argument("--sizes", action="store_true")
    options = parser.parse_args(argv)
    if options.sizes:
        print("\n".join(sizes()))
        return 0
    if options.runs < 1:
        print("benchmarks.startup: error: --runs begins at 1", file=sys.stderr)
        return 2
    bare, _ = cost("pass", options.runs)
    with_numpy, _ = cost("import numpy", options.runs)
    print(f"Python {1e3 * bare:.0f} ms, with NumPy {1e3 * with_numpy:.0f} ms (processor time)")
    print(
        *markdown("command | --help, ms | loaded, ms | of Python with NumPy | packages"), sep="\n"
    )
    show = _SHOW.format(heavy=HEAVY)
    for name in names:
        help_time, _ = cost(
            f"from gcs_sysid.cli.program import run; run(['{name}', '--help'])", options.runs
        )
        loaded, packages = cost(
            "from gcs_sysid.cli.commands import build_parser; build_parser();"
            f"import gcs_sysid.cli.{name}_command; {show}",
            options.runs,
        )
        print(
            f"| {name} | {1e3 * help_time:.0f} | {1e3 * loaded:.0f} | {loaded / with_numpy:.2f} | "
            f"{packages} |",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
