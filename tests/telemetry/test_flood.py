"""Others on the vehicle's port: they cost it nothing, and get no answers."""

import socket
import sys

import pytest

from gcs_sysid.errors import LinkError
from gcs_sysid.telemetry.link import UdpLink, open_link
from gcs_sysid.telemetry.urls import LinkUrl, parse_url

FLOOD = 40
"""Datagrams in a second that count as one here."""
linux = pytest.mark.skipif(sys.platform != "linux", reason="sockets are preferred on Linux alone")


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


class Field:
    """A link on loopback, a vehicle that it answers to, and a stranger."""

    def __init__(self):
        self.clock = Clock()
        self.link = UdpLink(LinkUrl("udpin", "udpin:127.0.0.1", "127.0.0.1"), self.clock)
        self.vehicle, self.attacker, self.other = (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)
        )
        for each in (self.vehicle, self.attacker, self.other):
            each.bind(("127.0.0.1", 0))
        self.link.answer_to(self.vehicle.getsockname())

    def say(self, who, *words):
        for word in words:
            who.sendto(word, ("127.0.0.1", self.link.port))

    def flood(self, count):
        self.say(self.attacker, *[b"garbage"] * count)

    def heard(self, who):
        chunks = self.link.receive(0.0)
        return [c.data for c in chunks if c.source == who.getsockname()]

    def close(self):
        self.link.close()
        for each in (self.vehicle, self.attacker, self.other):
            each.close()


@pytest.fixture
def field(monkeypatch):
    monkeypatch.setattr(UdpLink, "FLOOD", FLOOD)
    monkeypatch.setattr(UdpLink, "STRANGERS_AT_ONCE", 1)
    # The smallest that Linux gives: a handful of datagrams.
    monkeypatch.setattr(UdpLink, "RECEIVE_BUFFER", 1)
    field = Field()
    yield field
    field.close()


def set_apart(field):
    for _ in range(100):
        field.flood(2)
        field.link.receive(0.0)
        if field.link.floods:
            return
    raise AssertionError("never found to be flooded")


@linux
def test_a_flood_that_fills_the_buffer_costs_the_vehicle_nothing(field):
    set_apart(field)
    for number in range(50):
        field.flood(100)
        field.say(field.vehicle, b"%d" % number)
        assert field.heard(field.vehicle) == [b"%d" % number]
    assert field.link.floods == 1


@linux
def test_what_the_vehicle_sent_before_comes_first(field):
    for _ in range(FLOOD):
        field.flood(1)
        field.link.receive(0.0)
    field.say(field.vehicle, b"before")
    field.flood(1)
    assert field.heard(field.vehicle) == [b"before"]
    field.say(field.vehicle, b"after")
    assert field.heard(field.vehicle) == [b"after"]


@linux
def test_others_are_still_heard_a_few_at_a_time(field):
    set_apart(field)
    while field.heard(field.attacker):
        pass
    field.say(field.attacker, b"1", b"2")
    assert field.heard(field.attacker) == [b"1"]
    assert field.heard(field.attacker) == [b"2"]


@linux
def test_a_vehicle_that_comes_back_from_another_port_is_heard(field):
    set_apart(field)
    field.say(field.vehicle, b"last")
    assert field.heard(field.vehicle) == [b"last"]
    field.clock.now += 2.5
    assert field.heard(field.vehicle) == []
    field.say(field.other, b"again")
    assert field.heard(field.other) == [b"again"]
    field.link.answer_to(field.other.getsockname())
    field.link.send(b"hello")
    assert field.other.recv(10) == b"hello"


@linux
def test_nobody_else_gets_the_port_and_answers_come_from_it(field):
    set_apart(field)
    with pytest.raises(LinkError, match="in use"):
        open_link(parse_url(f"udpin:127.0.0.1:{field.link.port}"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            thief.bind(("127.0.0.1", field.link.port))
    field.link.send(b"hello")
    data, source = field.vehicle.recvfrom(10)
    assert (data, source[1]) == (b"hello", field.link.port)


@linux
def test_a_vehicle_alone_is_no_flood(field):
    for _ in range(2 * FLOOD):
        field.say(field.vehicle, b"mine")
        assert field.heard(field.vehicle) == [b"mine"]
    assert field.link.floods == 0


@linux
def test_what_comes_slowly_is_no_flood(field):
    for _ in range(3):
        for _ in range(FLOOD // 2):
            field.flood(1)
            field.link.receive(0.0)
        field.clock.now += 1.1
    assert field.link.floods == 0
