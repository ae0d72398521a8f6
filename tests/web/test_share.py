"""One session, many viewers: snapshots go out, actions come back and are done once."""

import os
import pickle
import socket
import threading
from dataclasses import replace
from multiprocessing import AuthenticationError
from multiprocessing.connection import Client

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.screen import Actions
from gcs_sysid.screen.replay_app import ReplayApp
from gcs_sysid.screen.scene import Scene
from gcs_sysid.screen.widgets.transport import Transport
from gcs_sysid.web.share import Door, RemoteSource, Share
from tests.screen import fake


@pytest.fixture
def source():
    return fake.FakeSource(fake.snapshot())


@pytest.fixture
def share(source):
    acting = Actions(source.mark, source.reset, source.toggle_recording, absent="in a test")
    scene = Scene(fake.TRUTH, acting)
    share = Share(source, scene)
    share.start()
    yield share
    share.close()


@pytest.fixture
def viewer(share):
    """Looks in; whether it was told that the share is gone."""
    gone = threading.Event()
    viewers = []

    def viewer(door=None):
        found = RemoteSource(door or share.door, gone.set)
        found.start()
        viewers.append(found)
        return found

    viewer.gone = gone
    yield viewer
    for found in viewers:
        found.stop()


def until(condition, timeout=20.0):
    """Wait for what another thread does."""
    waiting = threading.Event()
    for _ in range(round(timeout / 0.02)):
        if condition():
            return True
        waiting.wait(0.02)
    return False


def test_every_viewer_sees_the_snapshot(share, source, viewer):
    first, second = viewer(), viewer()
    assert until(lambda: first.latest() and second.latest())
    assert first.latest().result.dumps() == source.snapshot.result.dumps()
    assert first.latest().history.t == pytest.approx(source.snapshot.history.t)
    known = first.latest()
    source.snapshot = replace(source.snapshot, t=99.0)
    assert until(lambda: first.latest().t == second.latest().t == 99.0)
    assert first.latest() is not known


def test_an_unchanged_snapshot_is_not_sent_again(share, source, viewer):
    one = viewer()
    assert until(one.latest)
    known = one.latest()
    asked = threading.Event()
    latest = source.latest
    source.latest = lambda: (asked.set(), latest())[1]
    assert asked.wait(20.0)
    assert one.latest() is known


def test_what_a_viewer_does_is_done_once_and_there(share, source, viewer):
    first, second = viewer(), viewer()
    first.scene.actions.mark("here")
    assert source.calls == ["mark 'here'"]
    assert second.scene.actions.toggle_recording() == "recording stopped"
    assert source.calls == ["mark 'here'", "record"]
    assert until(lambda: second.latest() and second.latest().events[-1].text == "here")


def test_why_something_failed_is_told(share, source, viewer):
    source.broken = True
    with pytest.raises(InputError, match="the disk is full"):
        viewer().scene.actions.mark("here")


def test_what_cannot_be_done_there_is_absent_here(share, viewer):
    actions = viewer().scene.actions
    assert actions.set_anchor is None
    assert actions.absent == "in a test"
    assert actions.export_targets == ()


def test_nothing_but_the_scenes_actions_can_be_called(share, source, viewer):
    one = viewer()
    for group, name in (("actions", "__class__"), ("actions", "set_anchor"), ("source", "stop")):
        with pytest.raises(InputError, match="is not available here"):
            one._call(group, name, ())
    assert source.calls == []


def test_a_viewer_that_leaves_ends_nothing(share, source, viewer):
    first, second = viewer(), viewer()
    assert until(first.latest)
    first.stop()
    assert until(lambda: not first._thread.is_alive())
    assert source.calls == []
    assert not viewer.gone.is_set()
    second.scene.actions.reset()
    assert source.calls == ["reset"]


def test_viewers_are_told_when_it_closes(source):
    share = Share(source, Scene())
    share.start()
    gone = threading.Event()
    viewer = RemoteSource(share.door, gone.set)
    viewer.start()
    share.close()
    assert gone.wait(20.0)
    with pytest.raises(InputError, match="has ended"):
        RemoteSource(share.door, gone.set)


def test_the_scene_of_a_replay_has_its_transport(source):
    told = []
    transport = Transport(
        lambda: "paused", lambda step: f"step {step}", lambda t: (told.append(t), "to")[1], str
    )
    share = Share(source, Scene(actions=Actions(absent="in a replay"), transport=transport))
    share.start()
    viewer = RemoteSource(share.door, lambda: None)
    try:
        scene = viewer.scene
        assert scene.transport.toggle_pause() == "paused"
        assert scene.transport.change_speed(-1) == "step -1"
        assert scene.transport.seek(12.5) == "to"
        assert told == [12.5]
        assert isinstance(scene.app(viewer), ReplayApp)
    finally:
        share.close()


def hung_up(link):
    try:
        link.recv_bytes()
    except (EOFError, OSError):
        return True
    return False


class Bomb:
    def __reduce__(self):
        return os._exit, (1,)


def test_nobody_without_the_key_is_listened_to(share, source, viewer):
    address = ("127.0.0.1", share.door.port)
    with pytest.raises(AuthenticationError):
        Client(address, "AF_INET", authkey=b"another key")
    with Client(address, "AF_INET") as attacker:  # sends what would end the process
        attacker.send_bytes(pickle.dumps(Bomb()))
        assert until(lambda: hung_up(attacker))
    # Somebody who says nothing at all keeps nobody waiting.
    with socket.create_connection(address):
        viewer().scene.actions.reset()
    assert source.calls == ["reset"]


def test_only_this_machine_reaches_it(share):
    host, _ = share._listener.address
    assert host == "127.0.0.1"


def test_a_door_is_told_as_text():
    door = Door(4711, b"\x00\xff" * 16)
    assert Door.parse(str(door)) == door
    with pytest.raises(ValueError, match="invalid literal"):
        Door.parse("")
