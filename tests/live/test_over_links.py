"""Live over UDP, TCP and serial: recorded flights sent again, and the emulator as it flies.

The sender is held back by what the session has taken, not by a clock.
"""

import contextlib
import math
import os
import threading
from dataclasses import dataclass

import numpy as np
import pytest

import sim_bridge.links
from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.telemetry.link import SerialLink, TcpLink, UdpLink
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.urls import LinkUrl
from sim_bridge import ardupilot
from sim_bridge.ardupilot import ArduPilot
from sim_bridge.missions import MISSIONS
from sim_bridge.playback import play
from sim_bridge.px4 import Px4
from sim_bridge.server import Pace, TruthFile, fly
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle

LISTEN = LiveOptions(listen_only=True, refit_interval=10.0)
LONGEST = 300.0
"""s; a session that has not ended by then never will."""
IN_FLIGHT = 100
"""Datagrams sent and not yet taken: what the smallest receive buffer holds."""


class Counted(UdpLink):
    """Tells how many datagrams were taken off it."""

    def __init__(self):
        super().__init__(LinkUrl("udpin", "udpin:127.0.0.1", host="127.0.0.1", port=0))
        self.taken = 0
        self.more = threading.Condition()

    def receive(self, timeout):
        chunks = super().receive(timeout)
        with self.more:
            self.taken += len(chunks)
            self.more.notify_all()
        return chunks


class CountedOut(sim_bridge.links.UdpLink):
    """Tells how many datagrams were sent."""

    sent = 0

    def _send(self, data):
        self.sent += 1
        super()._send(data)


class AsTaken:
    """Waits for the other side instead of the clock; notes the times asked for."""

    def __init__(self, link, out):
        self.link, self.out = link, out
        self.times = []

    def wait(self, flown):
        self.times.append(flown)
        with self.link.more:
            there = self.link.more.wait_for(
                lambda: self.out.sent - self.link.taken < IN_FLIGHT, LONGEST
            )
        assert there, "datagrams were lost"


class AtOnce:
    """Never waits: a stream of bytes holds its sender back by itself."""

    def wait(self, flown):
        pass


class OnceAsked:
    """Flies in real time until the session has asked for its rates, then as the wire allows.

    Else the emulator may be down again before it is asked.
    """

    FAST = 5000.0

    def __init__(self, pace, speaks):
        self._pace, self._streams, self._clock = pace, speaks.schedule.streams, Pace(1.0)

    def wait(self, flown):
        (self._pace if self._is_asked() else self._clock).wait(flown)

    def _is_asked(self):
        imu, rotors = ("HIGHRES_IMU", "RAW_IMU"), ("ESC_STATUS", "ESC_TELEMETRY_1_TO_4")
        sent = [
            self._streams[MESSAGE_IDS[name]].interval
            for names in (imu, rotors)
            for name in names
            if MESSAGE_IDS[name] in self._streams
        ]
        return sum(0.0 < interval <= self.FAST for interval in sent) >= 2


@dataclass(frozen=True)
class Wire:
    """The session's end of a link, the sender's, and what paces it."""

    link: object
    out: object
    pace: object


def udp():
    link = Counted()
    out = CountedOut("127.0.0.1", link.port, listen=False)
    yield Wire(link, out, AsTaken(link, out))


def tcp():
    link = TcpLink(LinkUrl("tcpin", "tcpin:127.0.0.1", host="127.0.0.1", port=0))
    yield Wire(link, sim_bridge.links.TcpLink("127.0.0.1", link.port, listen=False), AtOnce())


def serial():
    """Two serial ports, joined by a wire each way."""
    if not hasattr(os, "openpty"):
        pytest.skip("no pseudo terminals here")
    (one, port_one), (two, port_two) = os.openpty(), os.openpty()
    name = os.ttyname(port_two)
    link = SerialLink(LinkUrl("serial", name, device=name, baud=921600))
    out = sim_bridge.links.SerialLink(os.ttyname(port_one), 921600)
    os.close(port_one)
    os.close(port_two)

    def carry(source, target):
        with contextlib.suppress(OSError):  # one of the ports is closed
            while data := os.read(source, 4096):
                while data:
                    data = data[os.write(target, data) :]

    wires = [
        threading.Thread(target=carry, args=ends, daemon=True) for ends in ((one, two), (two, one))
    ]
    for wire in wires:
        wire.start()
    yield Wire(link, out, AtOnce())
    link.close()
    out.close()
    for wire in wires:
        wire.join(LONGEST)
    os.close(one)
    os.close(two)


@pytest.fixture
def wire(request):
    """A link of each kind."""
    made = request.param()
    ends = next(made)
    yield ends
    ends.link.close()
    ends.out.close()
    assert next(made, None) is None


def live(wire, airframe, send, options=LISTEN, path=None):
    """A live session while something is sent; its final result."""
    sent = threading.Event()
    session = LiveSession(wire.link, airframe, options, path, sender_gone=sent.is_set)
    session.start()
    send()
    sent.set()
    ended = session.join(LONGEST)
    session.stop()
    assert ended
    assert session.problem is None
    return session.final


def played(wire, recording, airframe, path=None):
    """Play a recording to a live session that only listens; its final result."""
    return live(wire, airframe, lambda: play(TlogReader(recording), wire.out, wire.pace), path=path)


def numbers(value, name=""):
    """All numbers in a result's JSON by where they stand."""
    if isinstance(value, dict):
        parts = [(f"{name}.{key}", inner) for key, inner in value.items()]
    elif isinstance(value, list):
        parts = [(f"{name}[{i}]", inner) for i, inner in enumerate(value)]
    else:
        return {name: value}
    return {k: v for at, inner in parts for k, v in numbers(inner, at).items()}


ONLY_THERE = {
    ".source",
    ".telemetry.clock_drift_ppm",
    ".telemetry.recorded",
    *(f".telemetry.receiver.{n}" for n in ("kernel_drops", "longest_wait", "not_learnt")),
    ".telemetry.receiver.too_slow_seconds",
}
"""The first differs by its nature, the others are told by the recording's own times, or by the
computer's, alone."""


def assert_same(first, second):
    # Health while it flies is no part of an analysis.
    a, b = (
        {name: value for name, value in numbers(r.as_json()).items() if name[:7] != ".health"}
        for r in (first, second)
    )
    assert a.keys() - ONLY_THERE == b.keys() - ONLY_THERE
    for name in a.keys() - ONLY_THERE:
        x, y = a[name], b[name]
        if isinstance(x, float) and isinstance(y, float):
            assert math.isclose(x, y, rel_tol=1e-6, abs_tol=1e-12), (name, x, y)
        else:
            assert x == y, name


RECORDED = {
    "px4-sih-default.tlog": ("px4-sih", 1.0),
    "ardupilot-sitl.tlog": ("ardupilot-quad-x", 1.6),
}


@pytest.mark.slow
@pytest.mark.parametrize("wire", [udp], indirect=True, ids=["udp"])
@pytest.mark.thorough
@pytest.mark.parametrize("name", RECORDED)
def test_recorded_flights_of_real_autopilots_give_live_what_analyze_gives(wire, name, shared_logs):
    vehicle, mass = RECORDED[name]
    airframe = load_airframe(vehicle).with_anchor("mass", mass)
    final = played(wire, shared_logs / name, airframe)
    assert final.telemetry["used_seconds"] > 100.0
    assert_same(final, analyze_log(shared_logs / name, airframe))
    span = [time_us for time_us, _ in TlogReader(shared_logs / name)]
    assert wire.pace.times[-1] == pytest.approx(1e-6 * (span[-1] - span[0]), abs=1e-3)


class CountsFrames:
    """The sender's end of a link, counting the frames that leave on it."""

    def __init__(self, out):
        self.out = out
        self.frames = 0

    def send(self, frames, time_us):
        self.frames += len(frames)
        self.out.send(frames, time_us)

    def receive(self):
        return self.out.receive()


def emulated(autopilot):
    """A flight of 12 s as one of the two autopilots; its simulation and what speaks."""
    gusts, sensors = np.random.SeedSequence(4).spawn(2)
    mission = MISSIONS["all-axes"]
    if autopilot == "px4":
        simulation = Simulation(load_vehicle("paper"), mission, gusts)
        return simulation, Px4(simulation, "mems", 0.02, 250.0, sensors)
    steps = {"step_us": ardupilot.STEP_US, "control_steps": ardupilot.LOOP_STEPS}
    simulation = Simulation(load_vehicle("paper"), mission, gusts, **steps)
    return simulation, ArduPilot(simulation, "mems", 0.02, sensors)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wire", "autopilot"),
    [
        pytest.param(udp, "px4", marks=pytest.mark.thorough),
        (serial, "ardupilot"),
        pytest.param(tcp, "ardupilot", marks=pytest.mark.thorough),
        pytest.param(serial, "px4", marks=pytest.mark.thorough),
    ],
    indirect=["wire"],
)
def test_every_message_of_the_emulator_is_used_or_accounted_for(wire, autopilot):
    """At 250 Hz, asked for by the session itself."""
    airframe = load_airframe("paper")
    simulation, speaks = emulated(autopilot)
    out = CountsFrames(wire.out)
    truth = TruthFile(None, simulation, speaks)
    options = LiveOptions(rate=250.0, refit_interval=10.0)
    final = live(
        wire,
        airframe,
        lambda: fly(simulation, speaks, [out], 12.0, OnceAsked(wire.pace, speaks), truth),
        options,
    )
    told = final.telemetry
    assert told["received"] == out.frames
    assert sum(told["fates"].values()) == told["received"]
    # Voltages have no time of their own, and may come before anything that has one.
    assert told["fates"]["dropped"] <= 2
    assert told["fates"]["others"] < 20  # those before its first heartbeat
    assert told["lost"] == told["bad_crc"] == told["unknown"] == told["garbage_bytes"] == 0
    counted = sum(entry["count"] for entry in told["messages"].values())
    assert counted == told["received"] - told["fates"]["others"]
    for name in ("HIGHRES_IMU", told["rotor_input"]["source"]):
        rates = [e["rate"] for n, e in told["messages"].items() if n.startswith(name)]
        # ArduPilot is asked for whole turns of its loop of 400 Hz.
        assert rates == pytest.approx([250.0 if autopilot == "px4" else 200.0], rel=0.05)
    assert final.vehicle["autopilot"] == autopilot
    assert told["late"] == 0
    assert told["used_seconds"] > 6.0
    assert final.parameters["Ixx"].value == pytest.approx(0.0165, rel=0.03)
