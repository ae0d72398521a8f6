"""The screen as text, against files in `golden/` that a human can read.

After a change that is meant: `UPDATE_GOLDEN=1 pytest tests/screen/test_golden.py`, then look at
the difference. Text instead of Textual's SVG: no fonts from the network, and a reviewer sees what
moved. Colours are checked apart, by their contrast.
"""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from rich.color import Color
from rich.style import Style

from gcs_sysid.session.snapshot import LinkState

from . import fake

GOLDEN = Path(__file__).parent / "golden"
SIZES = [(80, 24), (120, 40), (200, 50)]

STATES = {
    "flying": (fake.snapshot, fake.TRUTH),
    "no-truth": (fake.snapshot, None),
    "waiting": (fake.waiting, None),
    "bare": (fake.bare, None),
    "ended": (
        lambda: replace(fake.snapshot(), link=fake.link(LinkState.ENDED, recording="")),
        fake.TRUTH,
    ),
}


def check(name: str, text: str) -> None:
    path = GOLDEN / f"{name}.txt"
    if os.environ.get("UPDATE_GOLDEN"):
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8"), f"{path.name}: see the module's first lines"


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
async def test_flying(run_screen, size, theme):
    async with run_screen(fake.snapshot(), size=size) as s:
        if theme == "light":
            s.app.theme = "gcs-light"
            await s.settle()
        # Both themes against one file: a theme changes colours and not one letter.
        check(f"flying-{size[0]}x{size[1]}", s.text())


@pytest.mark.parametrize("page", ["plot", "vehicle", "events"])
async def test_pages_at_80x24(run_screen, page):
    async with run_screen(fake.snapshot()) as s:
        await s.press({"plot": "2", "vehicle": "3", "events": "4"}[page])
        check(f"page-{page}-80x24", s.text())


@pytest.mark.parametrize(
    ("state", "size"),
    [
        ("no-truth", (80, 24)),
        ("no-truth", (120, 40)),
        ("waiting", (80, 24)),
        ("bare", (120, 40)),
        ("ended", (80, 24)),
    ],
)
async def test_states(run_screen, state, size):
    make, truth = STATES[state]
    async with run_screen(make(), size=size, truth=truth) as s:
        check(f"{state}-{size[0]}x{size[1]}", s.text())


async def test_help(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.press("question_mark")
        check("help-80x24", s.text())


def luminance(color: Color) -> float:
    def linear(channel: float) -> float:
        return channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4

    red, green, blue = (linear(c / 255) for c in color.get_truecolor())
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(style: Style) -> float:
    one, other = luminance(style.color), luminance(style.bgcolor)
    return (max(one, other) + 0.05) / (min(one, other) + 0.05)


@pytest.mark.parametrize("theme", ["gcs-dark", "gcs-light"])
@pytest.mark.parametrize("state", ["flying", "waiting"])
async def test_all_text_stands_out_from_its_ground(run_screen, theme, state):
    """Words have the contrast that WCAG asks of text (4.5 to 1)."""
    make, truth = STATES[state]
    async with run_screen(make(), size=(120, 40), truth=truth) as s:
        s.app.theme = theme
        await s.settle()
        pale = {
            segment.text
            for line in s.segments()
            for segment in line
            if any(c.isalnum() for c in segment.text) and contrast(segment.style) < 4.5
        }
        assert not pale
