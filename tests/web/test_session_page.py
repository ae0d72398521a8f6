"""A session on a page: what goes out, and what a pilot asks for."""

import base64
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.history import History
from gcs_sysid.results.notebook_view import text
from gcs_sysid.results.snapshot import LinkState
from gcs_sysid.screen import EarlierResult, Scene
from gcs_sysid.screen.formatting import choose_exponents
from gcs_sysid.web import session_page
from gcs_sysid.web.page_json import MOST_POINTS, history_view, session_view
from gcs_sysid.web.session_page import SessionPage
from tests.screen import fake

from .conftest import Client, served


def row(view, name):
    return next(row for row in view["parameters"] if row["name"] == name)


def test_a_snapshot_in_words():
    view = session_view(replace(fake.snapshot(), advice=fake.advice()), fake.TRUTH, None)
    assert view["link"]["vehicle"] == "PX4 quadrotor 1:1"
    assert view["verdict"]["headline"] == "PARTIAL"
    assert view["verdict"]["sign"] == "~"
    found = row(view, "Ixx")
    assert (found["value"], found["half"], found["unit"]) == (
        "16.553",
        "± 0.081",
        "10⁻³\xa0kg\xa0m²",
    )
    assert (found["status"], found["sign"], found["percent"]) == ("identified", "✓", "0.49\u00a0%")
    assert found["error"] == "+0.32\u00a0%"
    assert 0.9 < found["done"] <= 1.0
    unknown = row(view, "rotor_inertia")
    assert (unknown["value"], unknown["status"], unknown["sign"]) == ("–", "unobservable", "✗")
    slow = {rate["name"] for rate in view["link"]["rates"] if rate["slow"]}
    assert slow == {"ACTUATOR_OUTPUT_STATUS"}  # 38 of 50 Hz, as on the screen
    assert view["coach"]["text"] == "roll and yaw together, ±20°, about 1 Hz, 10 s"
    assert view["coach"]["left"] == "6 s left"
    json.dumps(view, allow_nan=False)


def test_after_the_end_no_hint_says_what_to_fly():
    assert row(session_view(fake.snapshot(), {}, None), "Izz")["hint"].endswith("of its motion")
    ended = replace(fake.snapshot(), link=fake.link(LinkState.ENDED))
    assert row(session_view(ended, {}, None), "Izz")["hint"] == "sigma below 50 %"


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (0.0118, 4e-4, ("11.80", "± 0.78")),
        (4e-4, 4e-5, ("0.400", "± 0.078")),
        (0.132, 4e-3, ("132.0", "± 7.8")),
        (1e-5, 4e-5, ("~0", "(< 0.088 ms)")),
    ],
)
def test_delays_are_in_milliseconds_whatever_their_size(value, std, shown):
    timing = {"rotor_delay": Estimate(value, std, "s", "identified")}
    result = replace(fake.result(), timing=timing)
    t, course = np.arange(2.0), {"rotor_delay": np.full(2, value)}
    snapshot = replace(fake.snapshot(), result=result, history=History(t, course, course))
    found = row(session_view(snapshot, {}, None), "rotor_delay")
    assert (found["value"], found["half"]) == shown
    assert found["unit"] == ("" if found["value"] == "~0" else "ms")
    assert history_view(snapshot, "rotor_delay")["text"].endswith(" ms")
    assert choose_exponents(result, {}, {"s": 0})["s"] == -3
    line = next(line for line in text(result).splitlines() if "rotor_delay" in line)
    assert " ms " in line
    assert result.as_json()["timing"]["rotor_delay"]["unit"] == "s"
    assert result.as_json()["timing"]["rotor_delay"]["value"] == value


def test_the_order_stands_apart_from_what_it_is_for():
    text = "roll and yaw together: roll ±20°, 18 s: Ixy from 2.2 % to about 1.8 %"
    advice = replace(fake.advice(), text=text)
    coach = session_view(replace(fake.snapshot(), advice=advice), {}, None)["coach"]
    assert coach["text"] == "roll and yaw together: roll ±20°, 18 s"
    assert coach["aim"] == "Ixy from 2.2 % to about 1.8 %"


@pytest.mark.parametrize("make", [fake.waiting, fake.bare, fake.two_vehicles, fake.snapshot])
def test_every_snapshot_can_be_shown(make):
    snapshot = make()
    view = session_view(snapshot, {}, None)
    json.dumps(view, allow_nan=False)
    assert view["rotors"] == [] or len(view["rotors"]) == 4
    if make is fake.bare:
        assert row(view, "Ixx")["status"] == "waiting"
    for state in LinkState:
        link = replace(snapshot.link, state=state)
        assert session_view(replace(snapshot, link=link), {}, None)["link"]["state"] == state.value


def test_a_baseline_is_compared_with():
    view = session_view(fake.snapshot(), {}, EarlierResult("before.json", fake.earlier()))
    assert view["baseline"]["name"] == "before.json"
    assert view["baseline"]["sign"] == "≠"
    assert "Ixx" in view["baseline"]["text"]


def series(view, name):
    return np.frombuffer(base64.b64decode(view["arrays"][name]), "<f4")


def test_the_plot_has_a_bounded_number_of_points():
    view = history_view(fake.snapshot(), "Ixx", fake.TRUTH)
    assert MOST_POINTS / 2 < len(series(view, "history.t")) <= MOST_POINTS
    assert len(series(view, "history.t")) == len(series(view, "history.Ixx.low"))
    assert view["text"].startswith("Ixx, moment of inertia about the body x axis: (16.5")
    assert view["figures"]["history-Ixx"]["levels"][0]["y"] == fake.TRUTH["Ixx"]
    assert series(view, "history.Ixx")[-1] == pytest.approx(16.55e-3, rel=0.02)
    assert series(view, "history.t")[-1] == pytest.approx(fake.history().t[-1], rel=1e-3)
    json.dumps(view, allow_nan=False)
    assert history_view(fake.bare(), "Ixx")["figures"] == {}
    with pytest.raises(InputError, match="no parameter 'x'"):
        history_view(fake.snapshot(), "x")


def test_a_plot_without_an_interval_has_its_values():
    history = fake.history()
    history.std["Ixx"][:] = np.nan
    view = history_view(replace(fake.snapshot(), history=history), "Ixx")
    assert np.isnan(series(view, "history.Ixx.low")).all()
    assert np.isfinite(series(view, "history.Ixx")).any()


def test_every_viewer_sees_each_snapshot_once(site, source, viewer, pilot):
    with viewer.open("GET", "/live") as first, pilot.open("GET", "/live") as second:
        streams = viewer.stream(first), pilot.stream(second)
        for stream in streams:
            assert next(stream)["session"]["t"] == "00:42"
            assert next(stream)["health"]["look"] == 1
        source.snapshot = replace(source.snapshot, t=99.0)
        for stream in streams:
            assert next(stream)["session"]["t"] == "01:39"
        site.stop()
        for stream in streams:
            assert next(stream) == {"ended": True}
    assert source.calls == []


def test_there_is_room_for_so_many(viewer, monkeypatch):
    monkeypatch.setattr(session_page, "MOST_VIEWERS", 1)
    with viewer.open("GET", "/live") as first:
        assert first.status == 200
        assert viewer.get("/live") == (503, "1 viewers already\n")


def test_what_a_pilot_asks_for_is_done_once(pilot, source):
    for action, said in (
        ({"action": "mark", "text": "here\x1b[2J"}, ""),
        ({"action": "record"}, "recording stopped"),
        ({"action": "scale", "name": "mass", "value": 1.6}, "scale from mass = 1.6"),
        ({"action": "export", "target": "urdf"}, "written: paper.urdf"),
    ):
        status, text = pilot.post("/live/action", action)
        assert (status, json.loads(text)["said"]) == (200, said)
    assert source.calls == [
        "mark 'here\\\\x1b[2J'",
        "record",
        "anchor mass 1.6",
        "export urdf partial",
    ]


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (b"", "not valid JSON"),
        (b"\xff\xfe\x00", "not valid JSON"),
        (b"[" * 5000, "not valid JSON"),
        (b"[]", "must be a JSON object"),
        (b'{"action": 3}', "must be a JSON object"),
        (b'{"action": "stop"}', "'stop' is not available here"),
        (b'{"action": "__class__"}', "is not available here"),
        (b'{"action": "seek", "position": 1.0}', "is not available here"),
        (b'{"action": "mark", "text": 5}', "text: must be text"),
        (b'{"action": "mark", "text": "' + b"x" * 300 + b'"}', "text: must be text"),
        (b'{"action": "scale", "name": "mass"}', "value: must be a number"),
        (b'{"action": "scale", "name": "mass", "value": 1e999}', "value: must be a number"),
        (b'{"action": "scale", "name": "mass", "value": NaN}', "value: must be a number"),
        (b'{"action": "scale", "name": "arm", "value": 1}', "name must be"),
        (b'{"action": "export", "target": "../x"}', "no such export format"),
    ],
)
def test_malformed_messages_are_refused_in_a_line(pilot, source, body, why, capfd):
    status, text = pilot.post("/live/action", body)
    assert status == 400
    assert why in text
    assert text.count("\n") == 1
    assert source.calls == []
    assert capfd.readouterr().err == ""


def test_a_message_has_a_size(pilot, source):
    status, text = pilot.post("/live/action", b'{"action": "mark", "text": "' + b"x" * 100_000)
    assert (status, text.count("\n")) == (413, 1)
    assert source.calls == []


def test_a_defect_is_one_line_here_and_there(pilot, page, source, capfd):
    source.toggle_recording = None
    page._commands = None
    status, text = pilot.post("/live/action", {"action": "reset"})
    assert status == 500
    assert text.startswith("internal error")
    assert capfd.readouterr().err.count("\n") == 1


def test_a_replay_is_moved(source):
    told = []
    replay = SimpleNamespace(
        change_speed=lambda step: f"step {step}", seek=lambda t: (told.append(t), "to")[1]
    )
    page = SessionPage(source, Scene(replay=replay))
    source.snapshot = replace(source.snapshot, playback=fake.PLAYING)
    with served(page) as site:
        pilot = Client(site, "pilot")
        scene = json.loads(pilot.get("/live/scene")[1])
        assert scene["actions"] == ["pause", "seek", "skip", "speed"]
        assert pilot.post("/live/action", {"action": "seek", "position": 12.5})[0] == 200
        assert told == [12.5]
        assert json.loads(pilot.post("/live/action", {"action": "speed", "step": -3})[1]) == {
            "said": "step -1"
        }
        assert pilot.post("/live/action", {"action": "reset"})[0] == 400
        assert pilot.events(1)[0]["session"]["playback"]["state"] == "▶ 1x"


def test_health_is_that_of_the_screen_for_every_viewer(source, viewer):
    source.snapshot = replace(source.snapshot, health=None)
    with viewer.open("GET", "/live") as response:
        told = (event["health"] for event in viewer.stream(response) if "health" in event)
        assert next(told) == {"text": "No hover yet: hover for 10 s."}
        assert viewer.get("/live/health.svg") == (400, "No hover yet: hover for 10 s.\n")
        source.snapshot = replace(source.snapshot, health=fake.HEALTH)
        assert "s of hover" in next(told)["text"]
    status, text = viewer.get("/live/health.svg")
    assert status == 200
    assert text.startswith("<svg")
