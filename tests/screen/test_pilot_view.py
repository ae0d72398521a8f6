"""The pilot view: what is written large, in which states, and that it fits."""

import itertools
from dataclasses import replace

import pytest

from gcs_sysid.results.snapshot import Advice, LinkState
from gcs_sysid.screen.formatting import big
from gcs_sysid.screen.main_view import PilotScreen, blocks, pilot_lines
from gcs_sysid.screen.view import View

from . import fake
from .test_golden import THEMES, check_all_sizes, contrast


def led(**changes):
    return replace(fake.snapshot(), advice=fake.advice(), **changes)


def written(snapshot, silence=0.0):
    """The texts of all blocks, as long as there is room for them."""
    return [texts[0] for texts, _ in blocks(View(snapshot, {}, "", {}, silence))[0]]


@pytest.mark.slow
async def test_the_pilot_view(run_screen):
    async with run_screen(led()) as s:
        await s.press("l")
        await check_all_sizes(s, "pilot")


def test_it_says_what_to_fly_how_long_and_what_is_missing():
    assert written(led()) == [
        "LINK OK 00:42", "ROLL ±20° 1 HZ", "YAW ±20° 1 HZ", "6 S LEFT",
        "5/10 NEED K_M IYZ IZZ IXZ IXY",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("state", "first"),
    [
        (LinkState.LOST, "LINK LOST 12 S"),
        (LinkState.ENDED, "STREAM ENDED"),
        (LinkState.REPLAY, "REPLAY"),
        (LinkState.WAITING, "NO VEHICLE YET"),
    ],
)
def test_the_link_comes_first(state, first):
    """Without a link there is no order to follow."""
    texts = written(replace(fake.snapshot(), link=fake.link(state)), silence=12.0)
    assert texts[0] == first
    assert not any("LEFT" in text for text in texts)


def test_before_the_flight_and_at_its_end():
    assert written(None) == ["OPENING"]
    assert "ON GROUND" in written(replace(fake.snapshot(), flying=False))
    assert "ENOUGH" in written(replace(led(), advice=Advice("", "all within 2 %", enough=True)))


def test_it_fits_every_size():
    """A maneuver of two axes with room to spare: nothing is cut, and letters grow with the room."""
    view = View(led(), {}, "", {})
    heights = []
    for width in range(60, 301, 24):
        for height in range(18, 79, 10):
            lines = pilot_lines(view, width, height)
            assert len(lines) <= height
            assert max(sum(len(text) for text, _ in line) for line in lines) <= width
            # The last line of letters is that of the count, which is never cut off.
            assert "▀" in lines[-1][0][0] or "█" in lines[-1][0][0]
            heights.append((width, height, len(lines)))
    assert {n for w, h, n in heights if (w, h) == (60, 18)} == {16}
    assert max(n for *_, n in heights) >= 50


@pytest.mark.slow
async def test_its_keys(run_screen):
    async with run_screen(led()) as s:
        await s.press("l")
        assert isinstance(s.app.screen, PilotScreen)
        await s.press("m")
        assert s.source.calls == ["mark 'mark 1'"]
        assert "mark 1" in s.text()
        await s.press("r", "o")  # what would cost data is not here
        assert s.source.calls == ["mark 'mark 1'"]
        await s.serve(led(t=99.0))
        assert big("01:39")[0].strip() in s.lines()[0]
        await s.press("l")
        assert "01:39 flying" in s.lines()[0]  # drawn again on the way back
        await s.press("l", "escape")
        assert not isinstance(s.app.screen, PilotScreen)


@pytest.mark.slow
async def test_large_print_stands_out_from_its_ground(run_screen):
    async with run_screen(led()) as s:
        await s.press("l")
        for theme, state in itertools.product(THEMES, (LinkState.CONNECTED, LinkState.LOST)):
            s.app.theme = theme
            await s.serve(led(link=fake.link(state)))
            segments = [segment for line in s.segments() for segment in line if "█" in segment.text]
            assert segments
            assert min(contrast(segment.style) for segment in segments) >= 3.0  # of large text
