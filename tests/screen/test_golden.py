"""The screen as text, against files in `golden/` that a human can read.

After a change that is meant: `UPDATE_GOLDEN=1 pytest tests/screen/test_golden.py`, then look at
the difference. Text instead of Textual's SVG: no fonts from the network, and a reviewer sees what
moved. Colors are checked apart, by their contrast.
"""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from rich.color import Color
from rich.segment import Segment
from rich.style import Style

from gcs_sysid.results.snapshot import Advice, LinkState
from gcs_sysid.screen import EarlierResult

from . import fake

GOLDEN = Path(__file__).parent / "golden"
SIZES = [(80, 24), (120, 40), (200, 50)]


def advised():
    """All panels have something to say."""
    return replace(fake.snapshot(), advice=fake.advice())


def enough():
    """The coach has nothing left to fly."""
    told = "every interval is within 2 %: land when you like"
    result = replace(fake.result(), verdict="identified", reasons=())
    return replace(fake.snapshot(), result=result, advice=Advice("", told, enough=True))


def ended():
    return replace(fake.snapshot(), link=fake.link(LinkState.ENDED, recording=""))


BASELINE = EarlierResult("before.json", fake.earlier())
STATES = {
    "flying": (fake.snapshot, fake.TRUTH, None),
    "all": (advised, None, BASELINE),
    "enough": (enough, fake.TRUTH, None),
    "no-truth": (fake.snapshot, None, None),
    "waiting": (fake.waiting, None, None),
    "bare": (fake.bare, None, None),
    "ended": (ended, fake.TRUTH, None),
}
KEYS = {
    (80, 24): {"plot": "2", "motion": "3", "vehicle": "4", "events": "5", "health": "6"},
    (120, 40): {"motion": "3", "health": "6"},
    (200, 50): {"health": "6"},
}
"""What leads to the pages of each size."""
THEMES = ("gcs-dark", "gcs-light")
DIALOGS = {"help": "question_mark", "export": "e", "scale": "s", "baseline": "b", "vehicle": "v"}


def check(name: str, text: str) -> None:
    path = GOLDEN / f"{name}.txt"
    if os.environ.get("UPDATE_GOLDEN"):
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8"), f"{path.name}: see the module's first lines"


def named(size):
    return f"{size[0]}x{size[1]}"


IN_BOTH_THEMES = {"all-80x24", "export-80x24", "page-health-80x24", "pilot-80x24"}


async def check_themes(s, name):
    """Against one file: a theme changes colors and not one letter, on any kind of screen."""
    assert s.app.theme == "gcs-dark"
    check(name, s.text())
    if name in IN_BOTH_THEMES:
        s.app.theme = "gcs-light"
        await s.settle()
        check(name, s.text())
        s.app.theme = "gcs-dark"


async def check_all_sizes(s, name):
    """Of a terminal that is made larger."""
    for size in SIZES:
        await s.pilot.resize_terminal(*size)
        await s.settle()
        await check_themes(s, f"{name}-{named(size)}")


@pytest.mark.slow
@pytest.mark.parametrize("state", STATES)
async def test_states(run_screen, state):
    make, truth, baseline = STATES[state]
    async with run_screen(make(), truth=truth, baseline=baseline) as s:
        await check_all_sizes(s, state)


async def test_replay(run_replay):
    async with run_replay() as (s, _):
        await check_all_sizes(s, "replay")


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES, ids=named)
async def test_pages(run_screen, size):
    async with run_screen(fake.snapshot(), size=size) as s:
        for page, key in KEYS[size].items():
            await s.press(key)
            await check_themes(s, f"page-{page}-{named(size)}")


@pytest.mark.slow
@pytest.mark.parametrize("dialog", DIALOGS)
async def test_dialogs(run_screen, dialog, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the question for a file looks at what lies there
    async with run_screen(fake.two_vehicles()) as s:
        await s.press(DIALOGS[dialog])
        await check_all_sizes(s, dialog)


def luminance(color: Color) -> float:
    def linear(channel: float) -> float:
        return channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4

    red, green, blue = (linear(c / 255) for c in color.get_truecolor())
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(style: Style) -> float:
    one, other = luminance(style.color), luminance(style.bgcolor)
    return (max(one, other) + 0.05) / (min(one, other) + 0.05)


def pale(lines):
    return {
        segment.text
        for line in lines
        for segment in line
        if any(c.isalnum() for c in segment.text) and contrast(segment.style) < 4.5
    }


@pytest.mark.slow
@pytest.mark.parametrize("state", ["all", "waiting"])
async def test_all_text_stands_out_from_its_ground(run_screen, state):
    """Words have the contrast that WCAG asks of text (4.5 to 1)."""
    make, truth, baseline = STATES[state]
    async with run_screen(make(), size=(200, 50), truth=truth, baseline=baseline) as s:
        for theme in THEMES:
            s.app.theme = theme
            await s.settle()
            assert not pale(s.segments()), theme


@pytest.mark.slow
async def test_questions_stand_out_from_their_ground(run_screen):
    async with run_screen(fake.two_vehicles()) as s:
        for dialog, key in DIALOGS.items():
            await s.press(key)
            inside = s.app.screen.query(".dialog, #help-box").first().region
            for theme in THEMES:
                s.app.theme = theme
                await s.settle()
                lines = [
                    list(Segment.divide(line, [inside.x, inside.right]))[1]
                    for line in s.segments()[inside.y : inside.bottom]
                ]
                assert not pale(lines), (dialog, theme)
            await s.press("escape")
