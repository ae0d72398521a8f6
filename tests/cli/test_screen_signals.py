"""A signal ends the screen and its session, whenever it comes."""

import os
import threading
from signal import SIGTERM, raise_signal

import pytest

from gcs_sysid.__main__ import main
from gcs_sysid.cli import followed_session
from gcs_sysid.screen.app import SysidApp
from gcs_sysid.screen.main_view import MainScreen

PATIENCE = 40.0
"""s; nothing waits so long where all is well."""


def before_it_runs(monkeypatch, run):
    def raised(app):
        raise_signal(SIGTERM)
        run(app)

    monkeypatch.setattr(SysidApp, "run", raised)


def while_it_is_built(monkeypatch, run):
    compose = MainScreen.compose

    def raised(screen):
        raise_signal(SIGTERM)
        yield from compose(screen)

    monkeypatch.setattr(MainScreen, "compose", raised)


def before_the_first_drawing(monkeypatch, run):
    poll = SysidApp.poll

    def raised(app, force=False):
        raise_signal(SIGTERM)
        poll(app, force)

    monkeypatch.setattr(SysidApp, "poll", raised)


@pytest.mark.slow
@pytest.mark.parametrize("when", [before_it_runs, while_it_is_built, before_the_first_drawing])
def test_a_signal_that_comes_early_ends_the_session(when, monkeypatch, capsys):
    run = SysidApp.run

    def headless(app):
        run(app, headless=True, size=(80, 24))

    monkeypatch.setattr(followed_session, "is_watched", lambda options: True)
    monkeypatch.setattr(SysidApp, "run", headless)
    when(monkeypatch, headless)
    lost = []
    again = threading.Timer(PATIENCE, lambda: (lost.append(1), os.kill(os.getpid(), SIGTERM)))
    again.start()
    words = ["--airframe", "paper", "--no-record", "--listen-only"]
    try:
        assert main(["live", "udpin:127.0.0.1:45992", *words]) == 1
    finally:
        again.cancel()
    assert not lost
    out, err = capsys.readouterr()
    assert "no heartbeat" in out
    assert "screen has failed" not in err
