"""What the program must not do to the machine it runs on, nor to who reads what it prints."""

import ast
import io
import json
import re
import tracemalloc
from pathlib import Path

import pytest

import gcs_sysid
import sim_bridge
from gcs_sysid.cli.program import run
from gcs_sysid.errors import LONGEST_LINE, InputError, one_line
from gcs_sysid.files import MOST_BYTES_OF_TEXT, read_text, write_whole
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result_file import read_result
from gcs_sysid.telemetry.link import UdpLink
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.signing import read_key
from gcs_sysid.telemetry.urls import parse_url
from sim_bridge.swings import read_plan

TOOL = Path(gcs_sysid.__file__).parent
ROOTS = [TOOL, Path(sim_bridge.__file__).parent]
# Between processes of the program itself: the pipes to a child and from it.
MAY_PICKLE = {"web/log_report.py", "live/receiver_process.py"}


def modules(words, *roots):
    """(name, nodes) of every module with one of these words; of the tool alone with TOOL."""
    for root in roots or ROOTS:
        for path in sorted(root.rglob("*.py")):
            text = path.read_text("utf-8")
            if re.search(words, text):  # to parse those that have none would take seconds
                yield path.relative_to(root).as_posix(), list(ast.walk(ast.parse(text)))


def name_of(node):
    """f for f, a.f for a.f; "" for what is computed."""
    if isinstance(node, ast.Attribute):
        return f"{name_of(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def called(nodes):
    """(name, call) of what is called."""
    return [(name_of(node.func), node) for node in nodes if isinstance(node, ast.Call)]


def imported(nodes):
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


def test_nothing_is_evaluated():
    forbidden = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "yaml.load"}
    words = r"(?<![.\w])(eval|exec|compile|__import__|os|yaml)\b|shell|allow_pickle"
    for name, tree in modules(words):
        for function, node in called(tree):
            assert function not in forbidden, name
            told = {k.arg for k in node.keywords if getattr(k.value, "value", None) is True}
            assert not told & {"shell", "allow_pickle"}, name


def test_nothing_is_unpickled_that_comes_from_outside():
    unsafe = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "yaml", "joblib"}
    users = {
        name
        for name, tree in modules("|".join(unsafe))
        if any(i.split(".")[0] in unsafe for i in imported(tree))
    }
    assert users == MAY_PICKLE


def test_what_listens_alone_has_no_gate():
    """The doctor opens links, and nothing in it can send."""
    for name, tree in modules(r"outgoing|\bsend"):
        if name.startswith("setup_help/"):
            assert "gcs_sysid.telemetry.outgoing" not in set(imported(tree)), name
            assert not [f for f, _ in called(tree) if f.split(".")[-1] in ("send", "sendto")], name


def test_every_way_out_of_the_gate_is_known():
    """A new one has to be thought about, here and in docs/security.md."""
    ways = {name for name in vars(Gate) if not name.startswith("_")}
    assert ways == {
        "signing", "send", "heartbeat", "set_message_interval", "get_message_interval",
        "request_message_interval",
        "request_group", "read_parameter",
        "request_log_list", "request_log_data", "end_log_requests", "request_file",
    }  # fmt: skip


READERS = {
    "airframe": (lambda path: load_airframe(str(path)), ".toml"),
    "plan": (read_plan, ".json"),
    "key": (read_key, ".key"),
}


@pytest.mark.parametrize("name", READERS)
def test_files_read_whole_have_a_limit(name, tmp_path):
    read, suffix = READERS[name]
    path = tmp_path / f"large{suffix}"
    with path.open("wb") as file:
        file.truncate(20_000_000_000)  # a hole: takes no room on the disk
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="too large") as error:
            read(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert "\n" not in str(error.value)
    assert peak < 10 * MOST_BYTES_OF_TEXT


def test_a_device_that_never_ends_is_no_file():
    with pytest.raises(InputError, match="too large"):
        read_text(Path("/dev/zero"), "the file", 1000)


@pytest.mark.parametrize("opening", ["[", '{"a":'])
def test_deep_nesting_is_one_line(opening, tmp_path):
    path = tmp_path / "deep.json"
    path.write_text(opening * 100_000)
    for read in (read_result, read_plan):
        with pytest.raises(InputError, match=r"JSON|plan") as error:
            read(path)
        assert "\n" not in str(error.value)


HOSTILE = "a\x1b]0;owned\x07\x1b[2J\r\nb\u202ec\x9b31m\udc9b"


def test_text_of_others_is_one_printable_line():
    assert one_line("rotor µ ± 3 °") == "rotor µ ± 3 °"
    line = one_line(HOSTILE)
    assert line.isprintable()
    assert "\\x1b]0;owned\\x07" in line
    assert "\\u202e" in line
    assert len(one_line("x" * 10**6)) <= LONGEST_LINE
    assert str(InputError(HOSTILE)) == line


def test_an_error_cannot_write_to_the_terminal(tmp_path, capsys):
    name = str(tmp_path / "a\x1b[2J\nb.toml")
    assert run(["analyze", "x.tlog", "--airframe", name, "--mass", "1"]) == 2
    error = capsys.readouterr().err
    assert "\x1b" not in error
    assert error.count("\n") == 1


def test_names_in_logs_cannot_write_to_the_terminal(tmp_path, dataflash_file):
    dataflash_file.type("IMU", "Qf", "TimeUS,GyrX")
    dataflash_file.type("PARM", "QNf", "TimeUS,Name,Value")
    dataflash_file.type("\x1b[2J", "Q", "TimeUS")
    for t in (1, 2, 3):
        dataflash_file.row("IMU", t * 1000, 0.0)
        dataflash_file.row("PARM", t * 1000, "A\x1b[2J" if t == 2 else f"P{t}", 1.0)
    path = tmp_path / "x.bin"
    path.write_bytes(dataflash_file.bytes())
    log = open_log(path)
    assert set(log.parameters) == {"P1", "P3"}
    assert set(log.as_dict()["messages"]) == {"IMU", "PARM"}


RESULT = {
    "schema": "gcs-sysid/1", "verdict": "refused", "reasons": [HOSTILE], "source": HOSTILE,
    "rotor_input": "speed",
}  # fmt: skip


def test_results_of_others_cannot_write_to_the_terminal(tmp_path):
    path = tmp_path / "r.json"
    path.write_text(json.dumps(RESULT))
    result = read_result(path)
    assert result.source.isprintable()
    assert result.reasons[0].isprintable()


@pytest.mark.parametrize(
    "argv",
    [
        ["compare", "a.json", "a.json", "--json", "taken.json"],
        ["analyze", "x.tlog", "--airframe", "paper", "--json", "taken.json"],
        ["inspect", "x.tlog", "--json", "taken.json"],
        ["export", "a.json", "--to", "urdf", "-o", "taken.json"],
        ["replay", "x.tlog", "--airframe", "paper", "--headless", "--json", "taken.json"],
        ["live", "udpin:127.0.0.1:45990", "--airframe", "paper", "--headless", "--no-record",
         "--duration", "0.2", "--json", "taken.json"],
        ["plan", "--airframe", "px4-sih", "--mass", "1", "--json", "taken.json"],
        ["airframe", "new", "--layout", "px4-quad-x", "--arm", "0.2", "-o", "taken.toml"],
    ],
    ids=lambda argv: argv[0],
)  # fmt: skip
def test_no_command_writes_over_a_file_unasked(argv, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    Path("a.json").write_text(json.dumps(RESULT | {"reasons": [], "source": "x"}))
    for name in ("taken.json", "taken.toml"):
        Path(name).write_text("mine")
    assert run(argv) == 2
    error = capsys.readouterr().err
    assert "exists" in error
    assert Path("taken.json").read_text() == Path("taken.toml").read_text() == "mine"


def test_devices_are_written_to_and_never_replaced(tmp_path):
    from gcs_sysid.cli.output import check_outputs, write_text

    check_outputs("/dev/null", force=False)
    write_text("/dev/null", "{}", force=False)
    assert Path("/dev/null").is_char_device()
    with pytest.raises(InputError, match="cannot write"):
        write_whole(tmp_path / "a\0b", "x", replace=False)


def test_a_link_listens_where_it_was_told():
    with UdpLink(parse_url("udpin:127.0.0.1:45991")) as link:
        assert link._socket.getsockname() == ("127.0.0.1", 45991)
    for text in ("udpin:14550", "udpin::14550"):  # not to the world by leaving something out
        with pytest.raises(InputError, match="KIND:HOST:PORT"):
            parse_url(text)
