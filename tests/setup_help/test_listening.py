"""Ports and who is heard there; nothing is ever sent."""

import itertools
import os
import socket
from pathlib import Path

import pytest

from gcs_sysid.setup_help.checks import Sign
from gcs_sysid.setup_help.listening import (
    Ear,
    holder_of_udp_port,
    listen,
    open_ears,
    received,
    start_command,
)
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.link import Link, ReceivedBytes
from gcs_sysid.telemetry.urls import parse_url
from gcs_sysid.telemetry.vehicles import MavlinkSystem, VehicleSelector


def heartbeat(system=1, kind=mavlink.MAV_TYPE_QUADROTOR, autopilot=mavlink.MAV_AUTOPILOT_PX4):
    packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 0, 3)
    return bytes(message.pack(packer))


class Told(Link):
    """A link that brings what it is given, and takes nothing."""

    datagrams = True

    def __init__(self, *datagrams, name="udpin:0.0.0.0:14550"):
        super().__init__(parse_url(name))
        self._datagrams = list(datagrams)
        self.closed = False

    def receive(self, timeout):
        return [ReceivedBytes(self._datagrams.pop(0), ("1.2.3.4", 5))] if self._datagrams else []

    def send(self, data):
        pytest.fail("the doctor sends nothing")

    def close(self):
        self.closed = True


def findings_after(*links, seconds=3.0):
    ears = [Ear(link, VehicleSelector()) for link in links]
    listen(ears, seconds, clock=itertools.count(0.0, 0.1).__next__)
    assert all(link.closed for link in links)
    return received(ears, seconds)


def test_a_vehicle_with_the_command_to_start():
    (finding,) = findings_after(Told(heartbeat(), heartbeat()))
    assert finding.sign is Sign.OK
    assert finding.text == "PX4 quadrotor 1:1 on udpin:0.0.0.0:14550, 2 messages in 3 s"
    assert finding.advice == [
        "gcs-sysid live udpin:0.0.0.0:14550 --airframe auto --arm M --mass KG"
    ]


def test_several_vehicles_on_several_links():
    ardupilot = heartbeat(7, mavlink.MAV_TYPE_HEXAROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    findings = findings_after(
        Told(heartbeat(1), heartbeat(2)), Told(ardupilot, name="udpin:0.0.0.0:14445"), Told()
    )
    assert len(findings) == 3
    assert "--vehicle 2:1" in findings[1].advice[0]
    assert "--vehicle" not in findings[2].advice[0]
    assert "udpin:0.0.0.0:14445 --airframe auto" in findings[2].advice[0]


def test_nobody_and_nobody_that_flies():
    (finding,) = findings_after(Told(), Told(b"noise" * 20, name="/dev/ttyUSB0"))
    assert finding.sign is Sign.WARNING
    assert "no vehicle in 3 s" in finding.text
    assert finding.text.endswith(
        "; /dev/ttyUSB0: bytes arrive that are no MAVLink: check the baud rate"
    )
    assert any("gcs-sysid demo" in advice for advice in finding.advice)
    station = heartbeat(255, mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID)
    (finding,) = findings_after(Told(station))
    assert "no vehicle, but: ground station 255:1" in finding.text
    asked = Ear(Told(name="COM3"), VehicleSelector(), Sign.PROBLEM)
    heard = Ear(Told(heartbeat()), VehicleSelector())
    listen([asked, heard], 3.0, clock=itertools.count(0.0, 0.1).__next__)
    found = [(finding.sign, finding.text) for finding in received([asked, heard], 3.0)]
    assert found[0][0] is Sign.OK
    assert found[1:] == [(Sign.PROBLEM, "no vehicle in 3 s on COM3")]


def test_a_vehicle_of_no_usual_kind_needs_a_file():
    tri = MavlinkSystem(1, 1, mavlink.MAV_TYPE_TRICOPTER, mavlink.MAV_AUTOPILOT_PX4)
    assert "--airframe FILE.toml --mass KG" in start_command(tri, "COM3")


@pytest.fixture
def taken():
    """A UDP port in use, by this process."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        yield holder.getsockname()[1]


def test_a_port_in_use_and_a_free_one(taken):
    urls = [parse_url(f"udpin:127.0.0.1:{port}") for port in (taken, 45879)]
    ears, findings = open_ears(urls)
    for ear in ears:
        ear.link.close()
    assert [ear.url for ear in ears] == ["udpin:127.0.0.1:45879"]
    assert [finding.sign for finding in findings] == [Sign.WARNING, Sign.OK]
    assert findings[0].text.startswith("in use by")
    assert any("14445" in advice for advice in findings[0].advice)


def test_a_device_that_is_not_there_is_a_problem():
    ears, (finding,) = open_ears([parse_url("/dev/nonesuch")])
    assert (ears, finding.sign) == ([], Sign.PROBLEM)


@pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="Linux tells in /proc")
def test_who_has_a_port(taken):
    assert holder_of_udp_port(taken).endswith(f"(process {os.getpid()})")
    assert holder_of_udp_port(1) is None


def test_where_it_cannot_be_told(tmp_path):
    assert holder_of_udp_port(14550, proc=tmp_path) is None
