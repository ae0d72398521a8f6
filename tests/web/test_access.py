"""Who is let in, under which name, from which page, and what else is refused."""

import argparse
import socket

import pytest

from gcs_sysid.argument_types import web_address
from gcs_sysid.cli.program import run
from gcs_sysid.errors import InputError
from gcs_sysid.web.site import Access, Site, is_loopback

from .conftest import Client


def test_the_token_opens_and_becomes_a_cookie(site, pilot):
    nobody = Client(site)
    status, text = nobody.get("/")
    assert status == 403
    assert "token" in text
    with nobody.open("GET", f"/?token={pilot.token}") as response:
        assert response.status == 200
        cookie = response.getheader("Set-Cookie")
    assert cookie.startswith(f"gcs-sysid-{site.access.port}={pilot.token};")
    for word in ("HttpOnly", "SameSite=Strict", "Path=/"):
        assert word in cookie
    nobody.cookie = cookie.partition(";")[0]
    assert nobody.get("/")[0] == 200
    assert nobody.get("/role") == (200, '{"role": "pilot"}')


@pytest.mark.parametrize(
    "path", ["/", "/live", "/live/scene", "/live/history?name=Ixx", "/assets/live.js", "/role"]
)
@pytest.mark.parametrize("token", [None, "", "0" * 32, "ä", "x" * 5000])
def test_nothing_without_the_token(site, path, token):
    client = Client(site)
    client.cookie = None if token is None else f"{site.access.cookie}={token}".encode()
    status, text = client.get(path)
    assert status in (400, 403)
    assert text.count("\n") == 1 or status == 400
    assert "Ixx" not in text


@pytest.mark.parametrize(
    "host", ["evil.example:{port}", "pc:{port}", "pc.local:{port}", "127.0.0.1", "127.0.0.1:1",
             "192.168.1.5:{port}", "localhost.evil.example:{port}", "[::1]", "", None]
)  # fmt: skip
def test_other_host_names_are_refused(pilot, host):
    """A name that somebody else made point here (DNS rebinding), whatever it looks like."""
    name = host and host.format(port=pilot.port)
    status, text = pilot.get("/role", Host=name)
    assert status in (400, 403)
    assert "pilot" not in text


def test_localhost_is_the_same_machine(pilot):
    assert pilot.get("/role", Host=f"localhost:{pilot.port}")[0] == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://127.0.0.1:{port}.evil.example"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"},
        {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "cors"},
    ],
)
def test_other_pages_are_refused(pilot, source, headers):
    headers = {name: value.format(port=pilot.port) for name, value in headers.items()}
    assert pilot.get("/live/scene", **headers)[0] == 403
    assert pilot.post("/live/action", {"action": "reset"}, **headers)[0] == 403
    assert source.calls == []


def test_what_changes_something_needs_the_pages_origin(pilot, source):
    assert pilot.post("/live/action", {"action": "reset"}, Origin=None)[0] == 403
    assert source.calls == []
    # A link in a mail or a chat may lead here; what it leads to only shows.
    elsewhere = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate"}
    assert pilot.get("/", **elsewhere)[0] == 200


def test_a_viewer_can_change_nothing(viewer, pilot, source):
    for action in ("mark", "reset", "record", "scale", "export", "report"):
        status, text = viewer.post("/live/action", {"action": action})
        assert (status, text) == (403, "viewers can only look; the pilot's link allows this\n")
    assert viewer.ask("PUT", "/live/action", {})[0] == 403
    assert source.calls == []
    assert '"actions": []' in viewer.get("/live/scene")[1]
    assert pilot.post("/live/action", {"action": "reset"})[0] == 200
    assert source.calls == ["reset"]


def test_headers_keep_scripts_of_others_out(site, pilot):
    for client, path in ((pilot, "/"), (pilot, "/nowhere"), (Client(site), "/")):
        with client.open("GET", path) as response:
            policy = response.getheader("Content-Security-Policy")
            assert "default-src 'none'" in policy
            assert "script-src 'self';" in policy
            assert "unsafe" not in policy
            assert response.getheader("X-Content-Type-Options") == "nosniff"
            assert response.getheader("Referrer-Policy") == "same-origin"
            assert response.getheader("Server") == "gcs-sysid"
            assert response.getheader("Set-Cookie") is None


def test_the_pages_load_nothing_from_elsewhere(pilot):
    for name in ("", "assets/page.css", "assets/common.js", "assets/live.js", "assets/analysis.js"):
        status, text = pilot.get(f"/{name}")
        assert status == 200
        found = text.replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in found
        assert "https://" not in found
    assert pilot.get("/assets/live.html")[0] == 404
    assert pilot.get("/assets/..%2fsite.py")[0] == 404


@pytest.mark.parametrize(
    "garbage",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",  # somebody who wants TLS
        b"GET / HTTP/1.1\r\n" + b"x" * 20_000,
        b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n",
        b"POST /live/action HTTP/1.1\r\nContent-Length: -1\r\n\r\n",
        b"\xfd\x1c\x00\x00\x00\x01\x01\x1e\x00\x00" * 100,  # MAVLink
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    ],
)
def test_garbage_on_the_port_is_refused_and_harms_nothing(pilot, garbage, capfd):
    with socket.create_connection(("127.0.0.1", pilot.port), timeout=20) as link:
        link.sendall(garbage)
        link.shutdown(socket.SHUT_WR)
        answer = b""
        while piece := link.recv(65536):
            answer += piece
    assert answer == b"" or answer.split(b" ")[1] in (b"400", b"403", b"414", b"431")
    assert pilot.get("/role")[0] == 200
    assert capfd.readouterr().err == ""


# --- addresses


def hosts(served, reached, port=8000):
    access = Access(served)
    access.port = port
    return access.hosts(reached)


def test_a_port_in_use_is_one_clear_line(page):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        site = Site("127.0.0.1", taken.getsockname()[1], page)
        with pytest.raises(InputError, match=r"cannot serve on 127\.0\.0\.1:.* such as 8001"):
            site.start()


@pytest.mark.slow
def test_where_there_is_no_serving_no_session_begins(tmp_path, capsys):
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        socket.socket(type=socket.SOCK_DGRAM) as free,
    ):
        free.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{free.getsockname()[1]}"
        free.close()
        recording = tmp_path / "flight.tlog"
        live = ["live", url, "--airframe", "paper", "--record", str(recording)]
        port = str(taken.getsockname()[1])
        assert run([*live, "--web", port]) == 2
        assert run(["web", port]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 2
    assert all(
        line.startswith("gcs-sysid: error: cannot serve on 127.0.0.1:") for line in err.splitlines()
    )
    assert not recording.exists()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("8000", ("127.0.0.1", 8000)),
        ("0", ("127.0.0.1", 0)),
        ("0.0.0.0:80", ("0.0.0.0", 80)),
        ("[::1]:8000", ("::1", 8000)),
        ("field-pc:8000", ("field-pc", 8000)),
    ],
)
def test_addresses_are_read(text, expected):
    assert web_address(text) == expected


@pytest.mark.parametrize("text", [":8000", "8000:", "localhost", "1:99999", "udpin:0.0.0.0:x", ""])
def test_nothing_beyond_this_machine_without_a_host(text):
    with pytest.raises(argparse.ArgumentTypeError, match="HOST:"):
        web_address(text)


def test_it_is_known_who_can_reach_it():
    assert all(map(is_loopback, ("127.0.0.1", "127.0.0.2", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.5", "field-pc")))
