"""Logs on the page: taken within bounds, analyzed as by `analyze`, nothing left running."""

import json
import os
import socket
import time
from pathlib import Path
from urllib.parse import quote

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result_file import read_result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import HISTORY_INTERVAL, ChainOptions
from gcs_sysid.strict_json import json_text
from gcs_sysid.web import log_worker, workbench
from gcs_sysid.web.log_analysis import airframe_of
from gcs_sysid.web.log_request import PICTURE, RESULT, file_name, parse_request
from tests.results.test_comparison import result

from .conftest import Client, served

PAPER = {"airframe": {"kind": "builtin", "name": "paper"}}


def put(client, name, data):
    return client.ask("PUT", f"/items?name={quote(name)}", data)


def worker_ids():
    """Processes of this one's that analyze; Linux tells."""
    found = set()
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            parent = (entry / "stat").read_text().rpartition(")")[2].split()[1]
        except OSError:
            continue
        if b"gcs_sysid.web.log_worker" in words and int(parent) == os.getpid():
            found.add(int(entry.name))
    return found


def until(condition, timeout=60.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.02)


# --- what is taken


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("flight.tlog", "flight.tlog"),
        ("../../etc/flight.ulg", "flight.ulg"),
        ("C:\\logs\\a.bin", "a.bin"),
        ("\x1b[2Ja.bbl", "\\x1b[2Ja.bbl"),
        ("x" * 500 + ".tlog", "x" * 110 + ".tlog"),
    ],
)
def test_names_are_made_harmless(text, expected):
    assert file_name(text) == expected


@pytest.mark.parametrize("text", ["", "/", "..", "a/.."])
def test_a_file_needs_a_name(text):
    with pytest.raises(InputError, match="needs a name"):
        file_name(text)


def test_uploads_have_a_size(bench, monkeypatch):
    _, client, _ = bench
    monkeypatch.setattr(workbench, "MOST_LOG", 1 << 20)
    status, text = put(client, "a.tlog", b"x" * ((1 << 20) + 1))
    assert (status, text) == (413, "a.tlog: too large, more than 1 MB\n")

    def endless():
        for _ in range(64):
            yield b"x" * (1 << 16)

    # A length that is not told is counted as it comes.
    body = b"".join(b"%x\r\n%s\r\n" % (len(piece), piece) for piece in endless()) + b"0\r\n\r\n"
    try:
        status, _ = client.ask(
            "PUT", "/items?name=a.tlog", body, Transfer_Encoding="chunked", Content_Length=None
        )
        assert status == 413
    except ConnectionError:
        pass  # it is not listened to any further
    assert client.get("/items") == (200, "[]")
    assert put(client, "a.tlog", b"x" * (1 << 20))[0] == 200


def test_what_is_no_log_is_refused_in_a_line(bench):
    part, client, _ = bench
    for name, data in (
        ("a.exe", b"MZ"),
        ("a", b"x"),
        ("", b"x"),
        ("a.tlog", b""),
        ("a.json", b"{}"),
        ("a.json", b"\xff" * 100),
    ):
        status, text = put(client, name, data)
        assert (status, text.count("\n")) == (400, 1)
    assert list(part._folder.iterdir()) == []
    assert client.get("/items") == (200, "[]")


def test_an_upload_that_breaks_off_leaves_nothing(bench):
    part, client, _ = bench
    head = (
        "PUT /items?name=a.tlog HTTP/1.1",
        f"Host: 127.0.0.1:{client.port}",
        f"Origin: http://127.0.0.1:{client.port}",
        f"Cookie: {client.cookie}",
        "Content-Length: 1000000",
    )
    with socket.create_connection(("127.0.0.1", client.port)) as link:
        link.sendall("\r\n".join([*head, "", "x" * 1000]).encode())
        until(lambda: list(part._folder.rglob("upload.tlog")))
    until(lambda: list(part._folder.iterdir()) == [])


def test_the_oldest_go(bench, monkeypatch):
    part, client, _ = bench
    monkeypatch.setattr(workbench, "MOST_KEPT", 2)
    for n in range(3):
        put(client, f"{n}.tlog", b"x")
    names = [item["name"] for item in json.loads(client.get("/items")[1])]
    assert names == ["1.tlog", "2.tlog"]
    assert len(list(part._folder.iterdir())) == 2


def test_a_viewer_reads_only(bench):
    _, client, site = bench
    put(client, "a.tlog", b"x")
    viewer = Client(site, "viewer")
    key = json.loads(viewer.get("/items")[1])[0]["id"]
    assert put(viewer, "b.tlog", b"x")[0] == 403
    assert viewer.ask("DELETE", f"/items/{key}")[0] == 403
    assert viewer.post(f"/items/{key}/look", {})[0] == 403
    assert viewer.post(f"/items/{key}/analysis", PAPER)[0] == 403
    assert client.ask("DELETE", f"/items/{key}")[0] == 200
    assert client.get(f"/items/{key}/result")[0] == 400


def test_nothing_stays_when_it_ends(bench):
    part, client, site = bench
    put(client, "a.tlog", b"x")
    folder = part._folder
    assert folder.is_dir()
    site.stop()
    assert not folder.exists()


# --- requests


def request(**changes):
    return {**PAPER, "scale": {"name": "mass", "value": "1.5"}, **changes}


@pytest.mark.parametrize(
    ("document", "why"),
    [
        ([], "must be a JSON object"),
        ({}, "airframe: must be a JSON object"),
        (request(extra=1), "unknown key 'extra'"),
        (request(airframe={"kind": "auto"}), "kind must be one of"),
        (request(airframe={"kind": ["log"]}), "kind must be one of"),
        (request(airframe={"kind": "builtin", "name": "../paper"}), "no built-in airframe"),
        (request(airframe={"kind": "builtin", "name": 5}), "must be text"),
        (request(airframe={"kind": "file", "text": "x" * 70_000}), "at most 60000"),
        (request(airframe={"kind": "rotors", "rotors": [{}] * 40}), "more than 32"),
        (request(airframe={"kind": "rotors", "rotors": [{"x": 1, "y": "1", "spin": "cw"}] * 4}),
         "number 1: y must be a number"),
        (request(airframe={"kind": "rotors", "rotors": [{"x": 1e9, "y": 0, "spin": "cw"}] * 4}),
         "too far out"),
        (request(arm="-1"), r"arm \(m\) must be positive"),
        (request(arm=[1]), "arm: must be text"),
        (request(arm="0.25+-x"), "must be VALUE"),
        (request(scale={"name": "weight", "value": 1}), "name must be one of"),
        (request(scale={"name": "mass", "value": "nan"}), r"mass \(kg\) must be a number"),
        (request(scale={"name": "mass", "value": 1e9}), "must lie between"),
        (request(scale={"name": "mass"}), "must be text"),
    ],
)  # fmt: skip
def test_requests_are_checked(document, why):
    with pytest.raises(InputError, match=why):
        parse_request(document)


def test_an_airframe_of_the_page_is_that_of_the_command_line(tmp_path):
    log = tmp_path / "a.tlog"
    drawn = load_airframe("px4-quad-x").as_json()["rotors"]
    table = request(airframe={"kind": "rotors", "rotors": drawn}, arm="0.2±1%")
    airframe = airframe_of(parse_request(table), log)
    assert airframe.arm == pytest.approx(0.2)
    assert airframe.anchor() == ("mass", 1.5)
    assert airframe.uncertainty.arm.relative
    text = "\n".join(
        ["mass = 2.0", *(f"[[rotor]]\nx={r['x']}\ny={r['y']}\nspin='{r['spin']}'" for r in drawn)]
    )
    table = {"airframe": {"kind": "file", "name": "q.toml", "text": text}}
    assert airframe_of(parse_request(table), log).anchor() == ("mass", 2.0)
    with pytest.raises(InputError, match=r"^q\.toml: at least four"):
        airframe_of(parse_request({"airframe": {**table["airframe"], "text": ""}}), log)
    with pytest.raises(InputError, match="enter its mass"):
        airframe_of(parse_request({"airframe": {"kind": "builtin", "name": "px4-quad-x"}}), log)
    with pytest.raises(InputError, match="the picture: at least four"):
        airframe_of(parse_request({"airframe": {"kind": "rotors", "rotors": drawn[:3]}}), log)
    assert list(tmp_path.iterdir()) == []


# --- analysis


def test_the_airframe_is_proposed_from_the_log(fly):
    words = ("--airframe", "px4-hexa-x", "--duration", "3")
    flight = fly(*words, "--rate", "50", "--mission", "hover")
    shares = []
    found = log_worker.look(flight.tlog, lambda _stage, share: shares.append(share))
    assert found["vehicle"] == "PX4 hexarotor 1:1"
    assert found["duration"] > 2.0
    assert len(found["airframe"]["rotors"]) == 6
    assert found["airframe"]["arm"] == pytest.approx(load_airframe("px4-hexa-x").arm, rel=1e-3)
    assert shares
    asked = {"airframe": {"kind": "log"}, "scale": {"name": "mass", "value": 1.5}}
    assert len(airframe_of(parse_request(asked), flight.tlog).rotors) == 6


@pytest.mark.slow
def test_a_layout_that_only_the_flight_shows_is_proposed_as_analyze_takes_it(fly):
    words = ("--mission", "all-axes", "--duration", "15", "--rate", "50")
    log = fly(*words, "--param", "CA_AIRFRAME=1").tlog
    found = log_worker.look(log, lambda *_: None)["airframe"]
    assert found["by"] == "how the vehicle turns"
    assert found["arm"] is None
    with pytest.raises(InputError, match="enter the arm"):
        airframe_of(parse_request(request(airframe={"kind": "log"})), log)


@pytest.mark.slow
def test_a_log_without_its_layout_asks_for_one(fly):
    words = ("--mission", "hover", "--duration", "3", "--rate", "50")
    log = fly(*words, "--param", "CA_AIRFRAME=1").tlog
    assert log_worker.look(log, lambda *_: None)["airframe"] is None
    with pytest.raises(InputError, match="choose or draw the airframe"):
        airframe_of(parse_request(request(airframe={"kind": "log"})), log)


def lines_of(text):
    return [json.loads(line) for line in text.splitlines()]


@pytest.mark.thorough
def test_the_numbers_are_those_of_analyze(bench, paper_flight, tmp_path):
    _, client, site = bench
    data = paper_flight.tlog.read_bytes()
    key = json.loads(put(client, "my <b>flight<b>.tlog", data)[1])["id"]
    assert client.get(f"/items/{key}/report.html")[0] == 400
    status, text = client.post(f"/items/{key}/analysis", PAPER)
    assert status == 200
    said = lines_of(text)
    assert said[-1]["done"]["verdict"] in ("identified", "partial")
    shares = [line["progress"] for line in said[:-1]]
    assert shares == sorted(shares)
    assert len(shares) >= 3
    assert said[-2] == {"progress": 0.9, "stage": "writing the report"}
    options = ChainOptions(history_interval=HISTORY_INTERVAL)  # as of `analyze --report`
    expected = analyze_log(paper_flight.tlog, load_airframe("paper"), options=options).as_json()
    viewer = Client(site, "viewer")
    document = json.loads(viewer.get(f"/items/{key}/result.json")[1])
    assert document["parameters"].keys() == expected["parameters"].keys()
    for name, estimate in expected["parameters"].items():
        found = document["parameters"][name]
        assert found["status"] == estimate["status"]
        for number in ("value", "std"):
            assert found[number] == pytest.approx(estimate[number], rel=1e-9, abs=1e-15)
    assert document["source"] == "my <b>flight<b>.tlog"
    shown = json.loads(viewer.get(f"/items/{key}/result")[1])
    assert {row["name"] for row in shown["parameters"]} >= set(expected["parameters"])
    with viewer.open("GET", f"/items/{key}/report.html") as response:
        report = response.read().decode()
        assert response.getheader("Content-Security-Policy").startswith("sandbox allow-scripts;")
    assert "my &lt;b&gt;flight&lt;b&gt;.tlog" in report
    assert "<b>flight" not in report
    assert "/upload.tlog" not in report  # where it lay here
    assert all(f'<section id="{part}"' in report for part in ("health", "twin"))
    # A result that was saved is compared with it.
    saved = tmp_path / "saved.json"
    saved.write_text(json.dumps(document))
    assert read_result(saved).verdict == document["verdict"]
    other = json.loads(put(client, "saved.json", saved.read_bytes())[1])["id"]
    compared = json.loads(viewer.get(f"/comparison?before={other}&after={key}")[1])
    assert compared["verdict"] == "no_change_seen"
    assert {row["name"] for row in compared["rows"]} >= {"Ixx", "k_T"}
    assert client.get("/comparison?before=x&after=y")[0] == 400
    # What cannot be analyzed says why, in one line of the stream.
    bad = json.loads(put(client, "bad.ulg", b"ULog\x01\x12\x35\x01" + bytes(50))[1])["id"]
    said = lines_of(client.post(f"/items/{bad}/look", {})[1])
    assert "bad.ulg" in said[-1]["error"]
    assert str(tmp_path.parent) not in said[-1]["error"]


class OneRunHovers:
    """Stands for the processes that analyze: only in the first run is there a hover to draw."""

    def __init__(self, _most):
        self._pictures = iter(["<svg/>"])

    async def run(self, job):
        folder = Path(job["folder"])
        (folder / RESULT).write_text(json_text(result(Ixx=0.1).as_json()))
        for picture in self._pictures:
            (folder / PICTURE).write_text(picture)
            break
        yield {"done": {}}

    async def ended(self):
        pass


def test_what_is_shown_is_of_the_newest_run_alone(monkeypatch):
    monkeypatch.setattr(workbench, "WorkerPool", OneRunHovers)
    with served(workbench.Workbench()) as site:
        client = Client(site, "pilot")
        key = json.loads(put(client, "flight.tlog", b"\xfd" * 300)[1])["id"]
        shown = []
        for _ in range(2):
            assert client.post(f"/items/{key}/analysis", PAPER)[0] == 200
            shown.append(json.loads(client.get(f"/items/{key}/result")[1]))
        assert [each["health"] for each in shown] == [True, False]
        # A browser that has the picture of an address does not ask for it again.
        assert shown[0]["run"] != shown[1]["run"]
        assert client.get(f"/items/{key}/health.svg")[0] == 400


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks into /proc")


@needs_proc
@pytest.mark.thorough
def test_who_leaves_ends_what_was_done_for_them(bench, paper_flight, capfd):
    part, client, site = bench
    key = json.loads(put(client, "a.tlog", paper_flight.tlog.read_bytes())[1])["id"]
    body = json.dumps(PAPER).encode()
    with client.open("POST", f"/items/{key}/analysis", body) as response:
        assert json.loads(response.readline())["stage"] == "identifying"
        assert len(worker_ids()) == 1
        assert client.ask("DELETE", f"/items/{key}")[0] == 409
    until(lambda: not worker_ids())
    until(lambda: part._items[key].busy == 0)
    # So does the end of the server.
    with client.open("POST", f"/items/{key}/analysis", body) as response:
        until(worker_ids)
        site.stop()
        assert not worker_ids()
    assert "Traceback" not in capfd.readouterr().err
