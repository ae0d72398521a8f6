"""Install what `make dist` built in clean environments, and see that it works there.

    python tools/try_wheel.py [PYTHON ...]

For each Python: a new virtual environment; the wheel with the pinned versions; every command's
`--help` with warnings as errors; a whole demo without a screen; the core of the tests, run in the
unpacked sdist without its sources, so that only the wheel can be imported; then the sdist itself,
installed over it. Prints a row for each; ends with status 1 when anything failed.
"""

import argparse
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
CORE = ("model", "signals", "estimation", "results", "coach")
"""Folders of tests to run, without whole flights."""
TEST_TOOLS = ("pytest", "pytest-asyncio", "pytest-xdist", "hypothesis", "packaging", "pyulog")


class FailedStepError(Exception):
    """A step that did not work; its output is the message."""


def run(*argv: str | Path, cwd: Path) -> str:
    """Run a program; its output."""
    done = subprocess.run(
        [str(a) for a in argv], cwd=cwd, capture_output=True, text=True, timeout=1800
    )
    if done.returncode:
        raise FailedStepError(
            f"{' '.join(map(str, argv))}: status {done.returncode}\n{done.stdout[-4000:]}"
            f"{done.stderr[-4000:]}"
        )
    return done.stdout


def attempt(python: str, wheel: Path, sdist: Path, folder: Path) -> list[str]:
    """All of it with one Python; cells of a row."""
    env = folder / "env"
    run(python, "-m", "venv", env, cwd=folder)
    scripts = env / ("Scripts" if sys.platform == "win32" else "bin")
    inside = scripts / "python"
    pip = (inside, "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
           "--constraint", ROOT / "constraints.txt")  # fmt: skip
    run(*pip, wheel, cwd=folder)
    version = run(inside, "-c", "import platform; print(platform.python_version())", cwd=folder)
    listed = run(
        inside, "-X", "dev", "-W", "error", "-c",
        "from gcs_sysid.cli.commands import COMMANDS\n"
        "print(*(command.name for command in COMMANDS))",
        cwd=folder,
    ).split()  # fmt: skip
    for name in listed:
        run(inside, "-X", "dev", "-W", "error", "-m", "gcs_sysid", name, "--help", cwd=folder)
    demo = run(
        scripts / "gcs-sysid", "demo", "--headless", "--speed", "max", "--record",
        folder / "demo.tlog", cwd=folder,
    )  # fmt: skip
    if "identified" not in demo:
        raise FailedStepError(f"demo: {demo[-2000:]}")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (tree,) = (f for f in folder.iterdir() if (f / "PKG-INFO").exists())
    shutil.rmtree(tree / "src")
    shutil.rmtree(tree / "sim_bridge")
    run(*pip, *TEST_TOOLS, cwd=folder)
    tests = run(
        inside, "-m", "pytest", "-p", "no:cacheprovider", "-n", "auto", "-m",
        "not slow and not thorough", *(f"tests/{name}" for name in CORE), cwd=tree,
    )  # fmt: skip
    run(*pip, "--force-reinstall", "--no-deps", sdist, cwd=folder)
    built = run(scripts / "gcs-sysid", "--version", cwd=folder).strip()
    return [
        version.strip(),
        f"{len(listed)} commands",
        "demo",
        tests.strip().splitlines()[-1],
        built,
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Try each Python."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("python", nargs="*", default=[sys.executable])
    parser.add_argument("--dist", type=Path, default=ROOT / "dist")
    options = parser.parse_args(argv)
    wheels, sdists = sorted(options.dist.glob("*.whl")), sorted(options.dist.glob("*.tar.gz"))
    if len(wheels) != 1 or len(sdists) != 1:
        print(f"{options.dist}: one wheel and one sdist expected; run: make dist", file=sys.stderr)
        return 2
    worked = True
    for python in options.python:
        with tempfile.TemporaryDirectory() as name:
            try:
                cells = attempt(python, wheels[0].resolve(), sdists[0].resolve(), Path(name))
                print(" | ".join(cells), flush=True)
            except (FailedStepError, OSError) as error:
                worked = False
                print(f"{python}: {error}", flush=True)
    return 0 if worked else 1


if __name__ == "__main__":
    sys.exit(main())
