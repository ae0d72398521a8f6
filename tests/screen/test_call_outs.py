"""Call-outs: what is said, how often, and by a program that is never waited for."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from gcs_sysid.results.snapshot import Advice, LinkState
from gcs_sysid.screen.call_outs import Announcer, Speaker
from gcs_sysid.screen.snapshot_view import call_outs, pronounced

from . import fake


def led(**changes):
    return replace(fake.snapshot(), **{"advice": fake.advice()} | changes)


class Voice:
    """A speech program that says at once, or as long as a test wants."""

    def __init__(self, program="voice"):
        self.program, self.busy, self.said, self.stops = program, False, [], 0

    def say(self, text):
        self.said.append(text)

    def stop(self):
        self.busy = False
        self.stops += 1


@pytest.fixture
def voice():
    return Voice()


@pytest.fixture
def clock():
    return [100.0]


@pytest.fixture
def caller(voice, clock):
    return Announcer(voice, "voice", now=lambda: clock[0])


def test_the_words():
    found = call_outs(led())
    assert found == {
        "link": "Link is up.",
        "coach": "Fly roll plus or minus 20 degrees 1 hertz, yaw plus or minus 20 degrees 1 hertz, "
        "for 10 seconds.",
        "time": "",
        "verdict": "Partial, 5 of 10.",
    }
    last = replace(fake.advice(), progress=0.6)
    assert call_outs(led(advice=last))["time"] == "5 seconds left."
    done = Advice("", "every interval is within 2 %", enough=True)
    assert call_outs(led(advice=done))["coach"] == "Enough. Every interval is within the target."
    assert pronounced("Ixy from 12 % to 3 %, k_T, climb ±1 m") == (
        "I x y from 12 percent to 3 percent, k T, climb plus or minus 1 meters"
    )


def test_the_verdict_is_not_announced_before_there_are_data():
    refused = replace(fake.result(), verdict="refused")
    early = led(result=refused, used_seconds=1.0)
    assert call_outs(early)["verdict"] == ""
    assert call_outs(replace(early, used_seconds=20.0))["verdict"] == "Not yet, 5 of 10."


def test_nothing_is_said_twice_and_what_is_urgent_comes_first(caller, voice, clock):
    caller.see(led())
    for t in range(5):
        caller.see(led(t=50.0 + t))
    assert [text.partition(" ")[0] for text in voice.said] == ["Link", "Fly", "Partial,"]
    lost = led(link=fake.link(LinkState.LOST), advice=None)
    voice.busy = True  # in the middle of a sentence
    caller.see(lost)
    assert voice.said[-1] == "Link lost."
    assert voice.stops > 1
    caller.see(led())
    assert voice.said[-1] == "Link is up."
    caller.see(led())
    assert voice.said[-1].startswith("Fly roll")  # it holds again


def test_the_count_is_not_said_at_every_change(caller, voice, clock):
    result = fake.result()
    for n in range(40):
        clock[0] += 1.0
        better = replace(result, verdict="identified" if n % 2 else "partial")
        caller.see(led(result=better))
    counts = [text for text in voice.said if "of 10" in text]
    assert 2 <= len(counts) <= 3  # 40 s, at least 15 s apart


def test_while_it_speaks_the_newest_of_a_kind_waits(caller, voice, clock):
    caller.see(led())
    voice.busy = True
    clock[0] += 60.0
    for verdict in ("identified", "partial", "identified"):
        caller.see(led(result=replace(fake.result(), verdict=verdict)))
    voice.busy = False
    before = len(voice.said)
    for _ in range(5):
        caller.see(led(result=replace(fake.result(), verdict="identified")))
    assert voice.said[before:] == ["Fly roll plus or minus 20 degrees 1 hertz, yaw plus or minus "
        "20 degrees 1 hertz, for 10 seconds.", "Identified to ±190 %, 5 of 10."]  # fmt: skip


def test_the_bell(clock):
    rings = []
    caller = Announcer(Voice(""), "voice", lambda: rings.append(1), lambda: clock[0])
    assert caller.mode == "bell"  # no speech program
    assert "espeak-ng" in caller.describe()
    caller.see(led())
    caller.see(led(t=50.0))
    assert len(rings) == 1
    caller.see(led(link=fake.link(LinkState.LOST), advice=None))
    assert len(rings) == 2
    assert caller.next_mode() == "Call-outs: off."
    caller.see(led())
    assert len(rings) == 2


async def test_the_key(run_screen):
    async with run_screen(led()) as s:
        s.app.announcer.speaker = voice = Voice()
        for answer in ("voice (voice)", "bell", "off"):
            await s.press("a")
            assert s.answer() == f"Call-outs: {answer}."
            await s.serve(led(t=s.app.snapshot.t + 1.0))
        assert voice.said[:1] == ["Link is up."]
    assert voice.stops > 0


# --- programs

posix = pytest.mark.skipif(sys.platform == "win32", reason="scripts of a POSIX shell")


def program(folder, name, body):
    path = folder / name
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return str(path)


def settled(speaker):
    """Wait until nothing is being said."""
    while speaker.busy:
        speaker._running.wait(20.0)


@posix
def test_a_program_gets_the_text_and_one_that_fails_is_given_up(tmp_path):
    heard = tmp_path / "heard"
    paths = {
        "spd-say": program(tmp_path, "spd-say", "exit 1"),  # no daemon
        "espeak-ng": program(tmp_path, "espeak-ng", f'printf "%s|" "$@" >> {heard}'),
        "say": str(tmp_path / "gone"),
    }
    speaker = Speaker(paths.get)
    assert speaker.program == "spd-say"
    speaker.say("-- Link lost.")
    settled(speaker)
    assert heard.read_text() == "-v|en|Link lost.|"
    assert speaker.program == "espeak-ng"
    Path(paths["espeak-ng"]).unlink()
    speaker.say("Link is up.")  # neither it nor the last can be started
    assert (speaker.program, speaker.busy) == ("", False)


@posix
def test_speech_is_not_waited_for_and_ends_with_the_session(tmp_path):
    speaker = Speaker({"espeak": program(tmp_path, "espeak", "exec sleep 600")}.get)
    caller = Announcer(speaker, "voice")
    caller.see(led())
    running = speaker._running
    assert running is not None
    assert speaker.busy
    caller.close()
    assert running.returncode is not None
    with pytest.raises(ProcessLookupError):
        os.kill(running.pid, 0)
    caller.see(led(t=50.0))
    assert not speaker.busy
