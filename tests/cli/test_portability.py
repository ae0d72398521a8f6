"""Nothing in the product's path is of POSIX alone.

There is no Windows here. What Python lacks there is taken away from the product, and what is
stricter there is made strict; then the product runs.
"""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gcs_sysid.cli import program
from gcs_sysid.cli.output import on_signals

ROOT = Path(__file__).parents[2]
POSIX_ONLY = frozenset(
    {"crypt", "curses", "fcntl", "grp", "nis", "posix", "pty", "pwd", "readline", "resource"}
    | {"spwd", "syslog", "termios", "tty"}
)
PAPER = ("--airframe", "paper")

SITECUSTOMIZE = f"""\
import builtins, os, select, signal, socket

POSIX_ONLY = {sorted(POSIX_ONLY)!r}
OURS = ("gcs_sysid", "sim_bridge")
real_import, real_select = builtins.__import__, select.select

def import_as_on_windows(name, globals=None, locals=None, fromlist=(), level=0):
    importer = (globals or {{}}).get("__name__") or ""
    if level == 0 and name.partition(".")[0] in POSIX_ONLY and importer.startswith(OURS):
        raise ModuleNotFoundError(f"No module named {{name!r}} on Windows")
    return real_import(name, globals, locals, fromlist, level)

def select_as_on_windows(*waiting):
    lists = waiting[:3]
    assert any(lists), "Windows refuses to select from nothing"
    assert all(isinstance(one, socket.socket) for group in lists for one in group), waiting
    return real_select(*waiting)

builtins.__import__ = import_as_on_windows
select.select = select_as_on_windows
for module, names in {{
    os: "chown fchmod fchown fork forkpty getegid geteuid getgid getgroups getpgid getpgrp getuid "
        "initgroups killpg lchown mkfifo nice openpty posix_openpt pread pwrite sched_yield setsid "
        "sync",
    select: "poll epoll kqueue",
    signal: "SIGHUP SIGKILL SIGQUIT SIGALRM SIGUSR1 SIGUSR2 SIGPIPE SIGTSTP SIGWINCH alarm "
            "pause pthread_kill pthread_sigmask setitimer sigtimedwait sigwait siginterrupt",
}}.items():
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
"""


@pytest.fixture
def as_on_windows(tmp_path):
    """Runs a program as Windows would; (status, standard output, standard error)."""
    strict = tmp_path / "strict"
    strict.mkdir()
    (strict / "sitecustomize.py").write_text(SITECUSTOMIZE, encoding="utf-8")
    (tmp_path / "work").mkdir()

    def run(module, *argv, encoding="cp1252"):
        path = [str(strict), *filter(None, [os.environ.get("PYTHONPATH")])]
        done = subprocess.run(
            [sys.executable, "-X", "warn_default_encoding", "-m", module, *map(str, argv)],
            capture_output=True,
            cwd=tmp_path / "work",
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(path),
                "PYTHONIOENCODING": encoding,
                "PYTHONWARNINGS": "error::EncodingWarning",
            },
            timeout=300,
        )
        return done.returncode, done.stdout.decode(encoding), done.stderr.decode(encoding)

    return run


def test_the_stand_in_for_windows_is_strict(as_on_windows, tmp_path):
    for line, word in (
        ("import fcntl", "No module named"),
        ("import select; select.select([0], [], [], 0)", "AssertionError"),
        ("import signal; signal.SIGHUP", "SIGHUP"),
        ("open('x', 'w')", "EncodingWarning"),
    ):
        (tmp_path / "work" / "gcs_sysid_trial.py").write_text(line, encoding="utf-8")
        code = f"__name__ = 'gcs_sysid.trial'\n{line}\n"
        (tmp_path / "work" / "trial.py").write_text(code, encoding="utf-8")
        status, _, err = as_on_windows("trial")
        assert status == 1
        assert word in err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("argv", "encoding"),
    [
        (["live", "--help"], "cp1252"),
        ([], "cp1252"),
        (["airframe", "check", "paper"], "ascii"),
        (["--help"], "utf-8"),
    ],
)
def test_what_is_printed_never_fails_for_its_signs(as_on_windows, argv, encoding):
    status, out, err = as_on_windows("gcs_sysid", *argv, encoding=encoding)
    assert (status, err) == (0, "")
    assert len(out) > 300


@pytest.mark.slow
def test_the_doctor_and_the_wizard(as_on_windows, tmp_path):
    status, out, err = as_on_windows("gcs_sysid", "doctor", "--duration", "0.1")
    assert status in (0, 1), err
    assert "ok       Python" in out
    argv = ["airframe", "new", "--layout", "px4-octo-x", "--arm", "0.4", "--output", "octo.toml"]
    status, _, err = as_on_windows("gcs_sysid", *argv)
    assert status == 0, err
    assert (tmp_path / "work" / "octo.toml").exists()


@pytest.mark.thorough
def test_a_live_session_where_nobody_speaks_ends_after_its_duration(as_on_windows, tmp_path):
    argv = ["live", "udpin:127.0.0.1:45877", *PAPER, "--headless", "--duration", "0.5"]
    status, out, err = as_on_windows("gcs_sysid", *argv, "--no-record")
    assert status == 1
    assert "no vehicle yet" in err
    assert "no heartbeat" in out
    assert not (tmp_path / "work" / "logs").exists()


@pytest.mark.thorough
def test_the_demo_with_its_emulator(as_on_windows, tmp_path):
    argv = ["demo", "--headless", "--speed", "max", "--duration", "20", "--record", "d.tlog"]
    status, out, err = as_on_windows("gcs_sysid", *argv)
    assert status == 0, err
    assert "Ixx" in out
    assert (tmp_path / "work" / "d.tlog").stat().st_size > 100_000


def product_files():
    for folder in (ROOT / "src" / "gcs_sysid", ROOT / "sim_bridge"):
        yield from sorted(folder.rglob("*.py"))


def test_no_module_needs_what_posix_alone_has():
    """Such an import stands in a function, in a `try` that says what else to do."""
    words = re.compile(rf"\b({'|'.join(POSIX_ONLY)}|SIGHUP|SIGKILL|fork|openpty)\b")
    for path in product_files():
        text = path.read_text(encoding="utf-8")
        if not words.search(text):
            continue
        tree = ast.parse(text)
        allowed = {
            id(node)
            for guard in ast.walk(tree)
            if isinstance(guard, ast.Try)
            for body in guard.body
            for node in ast.walk(body)
        }
        for node in ast.walk(tree):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in names:
                if name.partition(".")[0] in POSIX_ONLY:
                    assert id(node) in allowed, f"{path}: line {node.lineno} imports {name}"
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                used = f"{node.value.id}.{node.attr}"
                posix = ("signal.SIGHUP", "signal.SIGKILL", "os.fork", "os.openpty")
                assert used not in posix, f"{path}: line {node.lineno}"


def test_signals_that_a_system_lacks_are_left_out(monkeypatch):
    import signal

    for name in ("SIGHUP", "SIGBREAK"):
        monkeypatch.delattr(signal, name, raising=False)
    stopped = []
    with on_signals(lambda: stopped.append(True)):
        signal.raise_signal(signal.SIGTERM)
    assert stopped == [True]


def test_the_error_of_windows_for_a_reader_that_has_gone(monkeypatch):
    invalid = OSError(22, "Invalid argument")
    assert program.reader_has_gone(BrokenPipeError())
    assert not program.reader_has_gone(invalid)
    monkeypatch.setattr(program.os, "name", "nt")
    assert program.reader_has_gone(invalid)
    assert not program.reader_has_gone(FileNotFoundError(2, "x"))
