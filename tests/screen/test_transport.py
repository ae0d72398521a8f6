"""The screen of a replay: every key, the bar, the click, and what it says."""

from dataclasses import replace

import pytest

from gcs_sysid.screen.key_commands import HelpScreen
from gcs_sysid.screen.snapshot_view import playback_text

from .fake import PLAYING

KEYS = {
    "space": ("pause",), "p": ("pause",), "left": ("skip", -10.0), "right": ("skip", 10.0),
    "shift+left": ("skip", -60.0), "shift+right": ("skip", 60.0), "home": ("seek", 0.0),
    "end": ("seek", 180.0), "left_square_bracket": ("speed", -1), "minus": ("speed", -1),
    "right_square_bracket": ("speed", 1), "plus": ("speed", 1), "equals_sign": ("speed", 1),
}  # fmt: skip


@pytest.mark.slow
async def test_every_key_asks_for_what_it_stands_for_and_says_so(run_replay):
    async with run_replay() as (s, asked):
        for key, call in KEYS.items():
            await s.press(key)
            assert asked == [call], key
            assert s.answer() == f"{call[0]} it is"
            asked.clear()
        # Pausing the replay leaves the display as it is.
        assert not s.app.paused


@pytest.mark.slow
async def test_the_bar_says_where_it_stands(run_replay):
    async with run_replay() as (s, _):
        first = s.source.snapshot
        later = replace(first, playback=replace(PLAYING, position=90.0, paused=True))
        for size in ((80, 24), (120, 40), (200, 50)):
            await s.pilot.resize_terminal(*size)
            await s.serve(first)
            line = next(line for line in s.lines() if "▶ 1x" in line)
            assert "00:45" in line
            assert "03:00" in line
            done, rest = line.count("━"), line.count("─")
            assert done == round((done + rest) / 4)
            assert len(line) <= size[0]
            await s.serve(later)
            assert any("‖ paused (1x)" in line and "01:30" in line for line in s.lines())


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "▶ 1x"),
        ({"speed": 10.0}, "▶ 10x"),
        ({"speed": float("inf")}, "▶ max"),
        ({"paused": True, "speed": 10.0}, "‖ paused (10x)"),
        ({"seeking": 95.0, "paused": True}, "» to 01:35"),
        ({"ended": True}, "■ end"),
    ],
)
def test_what_it_does_is_a_sign_and_a_word(changes, expected):
    assert playback_text(replace(PLAYING, **changes)) == expected


@pytest.mark.slow
async def test_a_click_into_the_bar_goes_there(run_replay):
    async with run_replay(size=(120, 40)) as (s, asked):
        row, line = next((n, line) for n, line in enumerate(s.lines()) if "▶ 1x" in line)
        start = line.index("━")
        end = line.rindex("─")
        for column, expected in ((start, 0.0), (end, 180.0), ((start + end) // 2, 90.0)):
            await s.pilot.click(offset=(column, row))
            await s.settle()
            assert asked.pop()[1] == pytest.approx(expected, abs=3.0)
        await s.pilot.click(offset=(2, row))
        await s.settle()
        assert asked == []


async def test_help_and_palette_know_the_replay(run_replay):
    async with run_replay() as (s, asked):
        commands = {c.title: c.callback for c in s.app.get_system_commands(s.app.screen)}
        commands["End"]()
        commands["Faster"]()
        assert asked == [("seek", 180.0), ("speed", 1)]
        assert "Plot k_T" in commands
        await s.press("question_mark")
        assert isinstance(s.app.screen, HelpScreen)
        assert "pause or resume the replay" in s.text()
        assert "pause the display" not in s.text()
