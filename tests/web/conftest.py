"""A session's page on a fake session, the workbench, and requests as a browser makes them."""

import http.client
import json
from contextlib import contextmanager
from urllib.parse import urlsplit

import pytest

from gcs_sysid.screen import Scene
from gcs_sysid.web.session_page import SessionPage
from gcs_sysid.web.site import Site
from gcs_sysid.web.workbench import Workbench
from tests.screen import fake


class Client:
    """Requests to one site, with the cookie of a role and the page's origin unless told else."""

    def __init__(self, site, role=None):
        self.host, self.port = "127.0.0.1", site.access.port
        self.token = (
            None if role is None else urlsplit(site.access.address(role)).query.partition("=")[2]
        )
        self.cookie = None if role is None else f"{site.access.cookie}={self.token}"

    @contextmanager
    def open(self, method, path, body=None, **headers):
        """The response while its connection is open; None takes a header away."""
        sent = {"Host": f"{self.host}:{self.port}", "Cookie": self.cookie}
        if method not in ("GET", "HEAD"):
            sent["Origin"] = f"http://{self.host}:{self.port}"
        sent |= {name.replace("_", "-"): value for name, value in headers.items()}
        link = http.client.HTTPConnection(self.host, self.port, timeout=60)
        try:
            link.putrequest(method, path, skip_host=True)
            if isinstance(body, bytes):
                sent.setdefault("Content-Length", str(len(body)))
            for name, value in sent.items():
                if value is not None:
                    link.putheader(name, value)
            link.endheaders(body)
            yield link.getresponse()
        finally:
            link.close()

    def ask(self, method, path, body=None, **headers):
        """Status and text of an answer."""
        if isinstance(body, dict | list):
            body = json.dumps(body).encode()
        with self.open(method, path, body, **headers) as response:
            return response.status, response.read().decode()

    def get(self, path, **headers):
        return self.ask("GET", path, **headers)

    def post(self, path, body, **headers):
        return self.ask("POST", path, body, **headers)

    def events(self, count):
        """The first so many events of the live stream."""
        with self.open("GET", "/live") as response:
            assert response.status == 200, response.read()
            return [event for event, _ in zip(self.stream(response), range(count), strict=False)]

    @staticmethod
    def stream(response):
        for line in response:
            if line.startswith(b"data: "):
                yield json.loads(line[6:])


@pytest.fixture
def source():
    return fake.FakeSource(fake.snapshot())


@pytest.fixture
def page(source):
    return SessionPage(source, Scene(fake.TRUTH, source, None, source.export, ("urdf",)))


@contextmanager
def served(part):
    site = Site("127.0.0.1", 0, part)
    site.start()
    try:
        yield site
    finally:
        site.stop()


@pytest.fixture
def site(page):
    with served(page) as site:
        yield site


@pytest.fixture
def pilot(site):
    return Client(site, "pilot")


@pytest.fixture
def viewer(site):
    return Client(site, "viewer")


@pytest.fixture
def bench():
    """The workbench, and a client that may use it."""
    part = Workbench()
    with served(part) as site:
        yield part, Client(site, "pilot"), site
