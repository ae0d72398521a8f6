"""The source as it stands here and as it was at a commit, and commands run from either."""

import io
import os
import re
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from testbed.recordings import PROJECT


class NoHistoryError(Exception):
    """There is no git, no repository, or no such commit in it."""


def git(*words: str) -> bytes:
    """Output of git.

    Raises:
        NoHistoryError: there is none.
    """
    command = ["git", "-C", str(PROJECT), *words]
    try:
        return subprocess.run(command, check=True, capture_output=True).stdout
    except (FileNotFoundError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", None) or str(error).encode()
        raise NoHistoryError(said.decode().strip().splitlines()[-1]) from None


def commit_of(name: str) -> str:
    """Short hash of a commit.

    Raises:
        NoHistoryError: there is no such commit.
    """
    return git("rev-parse", "--short=12", f"{name}^{{commit}}").decode().strip()


def last_release() -> str:
    """The commit that dated the newest section of the changelog.

    Raises:
        NoHistoryError: there is no such section, or no such commit.
    """
    text = (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8")
    dated = re.search(r"^## (\d\S*) - .*$", text, re.MULTILINE)
    if dated is None:
        raise NoHistoryError("the changelog has no release yet")
    commits = git("log", "--format=%h", f"-S{dated[0]}", "--", "CHANGELOG.md").split()
    if not commits:
        raise NoHistoryError(f"the history does not reach back to {dated[1]}")
    return commits[-1].decode()


def unpack(commit: str, folder: Path) -> Path:
    """A commit's tree, in a new folder.

    Raises:
        NoHistoryError: there is no such commit.
    """
    with tarfile.open(fileobj=io.BytesIO(git("archive", commit))) as tar:
        tar.extractall(folder, filter="data")
    return folder


@dataclass(frozen=True)
class Done:
    """A command that has ended.

    Attributes:
        status: exit status.
        seconds: of processor time.
        said: standard error.
    """

    status: int
    seconds: float
    said: str


def run(tree: Path, words: Sequence[str], folder: Path | None = None) -> Done:
    """Run a module's command from a tree, with this interpreter and its packages.

    Args:
        tree: of the project.
        words: module and arguments, as after `python -m`.
        folder: to run in.
    """
    path = os.pathsep.join([str(tree / "src"), str(tree)])
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", *words],
            stdout=subprocess.DEVNULL, stderr=said, env=environment, cwd=folder,
        )  # fmt: skip
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        return Done(process.returncode, usage.ru_utime + usage.ru_stime, said.read())
