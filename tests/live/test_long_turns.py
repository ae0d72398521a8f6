"""What keeps the data of a fast link waiting: turns of a session are kept short."""

import subprocess
import sys

LOADS = """
import sys
from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.link import Link, ReceivedBytes
from gcs_sysid.telemetry.urls import LinkUrl

class Sender(Link):
    datagrams = True
    receive = lambda self, timeout: [ReceivedBytes(data, ("127.0.0.1", 1)) for data in sent]
    send = close = lambda self, *data: None

heartbeat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
for sent in [], [bytes(heartbeat.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1)))]:
    link = Sender(LinkUrl("udpin", "udpin:nowhere"))
    session = LiveSession(link, load_airframe("paper"), LiveOptions(duration=0.1))
    session.start()
    assert session.join(60.0)
    print("scipy.optimize" in sys.modules, session.problem)
"""


def test_what_a_flight_loads_is_loaded_at_its_first_data() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADS], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.stdout.split() == ["False", "None", "True", "None"], done.stderr
