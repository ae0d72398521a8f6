"""Who is served, and where."""

import argparse
import asyncio
import socket

import aiohttp
import pytest

from gcs_sysid.cli.arguments import web_address
from gcs_sysid.cli.program import run
from gcs_sysid.errors import InputError
from gcs_sysid.web.share import Door
from gcs_sysid.web.site import Site, is_loopback, is_own

NOBODY = Door(1, b"key")


@pytest.fixture
def site():
    site = Site("127.0.0.1", 0, NOBODY)
    url = site.start()
    yield url
    site.stop()


def get(url, **headers):
    async def fetch():
        async with aiohttp.ClientSession() as session, session.get(url, headers=headers) as answer:
            return answer.status, await answer.text(), dict(answer.headers)

    return asyncio.run(fetch())


def test_the_page_loads_nothing_from_elsewhere(site):
    status, text, headers = get(site)
    assert status == 200
    assert "http://" not in text
    assert "https://" not in text
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    for name in ("css/xterm.css", "js/textual.js", "fonts/RobotoMono-VariableFont_wght.ttf"):
        assert f"/static/{name}" in text
    assert get(f"{site}/static/js/textual.js")[0] == 200


def test_other_pages_may_not_use_it(site):
    own = site.removeprefix("http://")
    assert get(site, Origin=site)[0] == 200
    assert get(f"{site}/ws", Origin="http://evil.example")[0] == 403
    # A name that somebody else made point here.
    assert get(site, Host="evil.example:8000", Origin="http://evil.example:8000")[0] == 403
    assert get(site, Host=own.replace("127.0.0.1", "localhost"))[0] == 200


@pytest.mark.parametrize(
    ("host", "origin", "own", "expected"),
    [
        ("127.0.0.1:8000", None, "127.0.0.1", True),
        ("127.0.0.1:8000", "http://127.0.0.1:8000", "127.0.0.1", True),
        ("127.0.0.1:8000", "http://127.0.0.1:9000", "127.0.0.1", False),
        ("127.0.0.1:8000", "null", "127.0.0.1", False),
        ("localhost:8000", "http://localhost:8000", "127.0.0.1", True),
        ("[::1]:8000", "http://[::1]:8000", "::1", True),
        ("192.168.1.5:8000", "http://192.168.1.5:8000", "0.0.0.0", True),
        ("field-pc.local:8000", "http://field-pc.local:8000", "0.0.0.0", True),
        ("gcs.example:8000", "http://gcs.example:8000", "gcs.example", True),
        ("evil.example:8000", "http://evil.example:8000", "0.0.0.0", False),
        ("", None, "127.0.0.1", False),
        (None, None, "127.0.0.1", False),
    ],
)
def test_own_requests_are_known(host, origin, own, expected):
    assert is_own(host, origin, own) is expected


def test_a_port_in_use_is_one_clear_line():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        site = Site("127.0.0.1", taken.getsockname()[1], NOBODY)
        with pytest.raises(InputError, match=r"cannot serve on 127\.0\.0\.1:.* --web 8001"):
            site.start()


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
        assert run([*live, "--web", str(taken.getsockname()[1])]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("gcs-sysid: error: cannot serve on 127.0.0.1:")
    assert err.count("\n") == 1
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
