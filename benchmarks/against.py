"""Processor time of the commands against the last release, in one run: part of `make bench`.

The release's tree is taken from the repository's history (`--against REF` names another commit) and
runs with the same interpreter and packages. Both trees take turns on one log; the least of each
counts, and their ratio means the same on any machine.
"""

import argparse
import io
import os
import re
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
MOST = 1.25
"""Times the release's processor time; beyond it, the exit status is 1."""
_FLIGHT = ["--airframe", "paper", "--mission", "all-axes", "--noise", "mems", "--rate", "250"]


def git(*words: str) -> bytes:
    """What git says.

    Raises:
        FileNotFoundError: there is no git.
        subprocess.CalledProcessError: it fails, as outside a repository.
    """
    command = ["git", "-C", str(PROJECT), *words]
    return subprocess.run(command, check=True, capture_output=True).stdout


def last_release() -> str:
    """The commit that dated the newest section of the changelog.

    Raises:
        ValueError: there is no such section, or no such commit.
    """
    text = (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8")
    dated = re.search(r"^## (\d\S*) - .*$", text, re.MULTILINE)
    if dated is None:
        raise ValueError("the changelog has no release yet")
    commits = git("log", "--format=%h", f"-S{dated[0]}", "--", "CHANGELOG.md").split()
    if not commits:
        raise ValueError(f"the history does not reach back to {dated[1]}")
    return commits[-1].decode()


def unpack(commit: str, folder: Path) -> Path:
    """A commit's tree."""
    with tarfile.open(fileobj=io.BytesIO(git("archive", commit))) as tar:
        tar.extractall(folder, filter="data")
    return folder


def cost(tree: Path, words: list[str]) -> float:
    """S of processor time of a command of a tree.

    Raises:
        RuntimeError: it fails.
    """
    path = os.pathsep.join([str(tree / "src"), str(tree)])
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", *words], stdout=said, stderr=said, env=environment
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, 1):  # 1: the flight allows no answer
            said.seek(0)
            raise RuntimeError(said.read().strip().splitlines()[-1])
    return usage.ru_utime + usage.ru_stime


def main() -> int:
    """Print the table; 1 where a command has become slower."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.against", description=__doc__)
    parser.add_argument("--against", metavar="REF", help="a commit (default: the last release)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of flight")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="turns of both")
    parser.add_argument("--only", metavar="WORD", default="", help="rows with this in their name")
    options = parser.parse_args()
    try:
        commit = options.against or last_release()
        with tempfile.TemporaryDirectory() as name:
            return _compare(unpack(commit, Path(name) / "release"), commit, Path(name), options)
    except (FileNotFoundError, ValueError, subprocess.CalledProcessError) as error:
        print(f"not compared with the last release: {error}")
        return 0


def _compare(release: Path, commit: str, folder: Path, options: argparse.Namespace) -> int:
    log, out = str(folder / "flight.tlog"), str(folder / "out.tlog")
    commanded = str(folder / "commands.tlog")
    fly = ["sim_bridge", *_FLIGHT, "--duration", str(options.seconds), "--speed", "max", "--tlog"]
    given = ["--airframe", "paper", "--json", os.devnull]
    commands = {
        "start (gcs-sysid --version)": ["gcs_sysid", "--version"],
        "emulator, to a file": [*fly, out, "--force"],
        "inspect": ["gcs_sysid", "inspect", log],
        "analyze": ["gcs_sysid", "analyze", log, *given],
        "analyze, on commands": ["gcs_sysid", "analyze", commanded, *given],
    }
    commands = {what: words for what, words in commands.items() if options.only in what}
    if not commands:
        raise ValueError(f"no row has {options.only!r} in its name")
    used = {word for words in commands.values() for word in words}
    if log in used:
        cost(PROJECT, [*fly, log])
    if commanded in used:
        cost(PROJECT, [*fly, commanded, "--rotor-input", "command"])
    slower = 0
    print(f"{'against ' + commit:<34}{'release, s':>12}{'now, s':>9}{'ratio':>8}{'bar':>9}")
    for what, words in commands.items():
        try:
            turns = [(cost(release, words), cost(PROJECT, words)) for _ in range(options.repeats)]
        except RuntimeError as error:
            print(f"{what:<34}  left out: {error}")
            continue
        before, now = (min(times) for times in zip(*turns, strict=True))
        slower += now > MOST * before
        print(f"{what:<34}{before:>12.2f}{now:>9.2f}{now / before:>8.2f}{f'<= {MOST:g}':>9}")
    return 1 if slower else 0


if __name__ == "__main__":
    sys.exit(main())
