"""The source as it was at a commit."""

import io
import re
import subprocess
import tarfile
from pathlib import Path

from testbed.study import PROJECT


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
