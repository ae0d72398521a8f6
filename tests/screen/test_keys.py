"""Every key, through Textual's Pilot: what the source is told and what the screen answers."""

from dataclasses import replace

import pytest
from textual.command import CommandPalette

from gcs_sysid.screen import Actions
from gcs_sysid.screen.help import HelpScreen
from gcs_sysid.screen.main import MainScreen
from gcs_sysid.screen.widgets.convergence import Convergence
from gcs_sysid.screen.widgets.pages import PAGES
from gcs_sysid.session.snapshot import Event

from . import fake


@pytest.mark.parametrize("key", ["q", "ctrl+c", "ctrl+q"])
async def test_quit_stops_the_session_and_asks_nothing(run_screen, key):
    async with run_screen(fake.snapshot()) as s:
        await s.pilot.press(key)
        await s.pilot.pause()
        assert s.source.calls == ["stop"]
        assert not s.app.is_running


@pytest.mark.parametrize(("down", "up"), [("down", "up"), ("j", "k")])
async def test_select_moves_through_the_parameters_and_around(run_screen, down, up):
    async with run_screen(fake.snapshot()) as s:
        assert s.app.selected == "Ixx"  # the first that is not given
        await s.press(down)
        assert s.app.selected == "Iyy"
        assert "Iyy" in s.answer()
        assert any(line.startswith("▸Iyy") for line in s.lines())
        await s.press(up, up, up)
        assert s.app.selected == "rotor_delay"


async def test_select_with_nothing_to_select(run_screen):
    async with run_screen(fake.waiting()) as s:
        await s.press("j")
        assert "No parameters yet" in s.answer()


async def test_reset(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.press("r")
        assert s.source.calls == ["reset"]
        assert "Reset" in s.answer()


async def test_marks_are_numbered(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.press("m", "m")
        assert s.source.calls == ["mark 'mark 1'", "mark 'mark 2'"]
        await s.press("4")
        assert sum("mark " in line for line in s.lines()[2:-2]) == 2


@pytest.mark.parametrize("key", ["R", "ctrl+r"])
async def test_record(run_screen, key):
    async with run_screen(fake.snapshot()) as s:
        await s.press(key)
        assert s.source.calls == ["record"]
        assert s.answer() == "recording stopped"
        await s.press(key)
        assert s.answer() == "recording to logs/next.tlog"


async def test_a_failed_action_says_why_and_the_screen_lives(run_screen):
    async with run_screen(fake.snapshot()) as s:
        s.source.broken = True
        for key in ("m", "r", "R"):
            await s.press(key)
            assert s.answer() == "Not done: the disk is full"
        s.source.broken = False
        await s.press("m")
        assert s.source.calls == ["mark 'mark 1'"]


async def test_pause_freezes_the_display_only(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.press("p")
        assert "Display paused" in s.text()
        await s.serve(replace(fake.snapshot(), t=99.0))
        assert "01:39" not in s.text()
        await s.press("p")
        assert "01:39" in s.text()
        assert "goes on" in s.answer()
        assert s.source.calls == []


async def test_dark_and_light(run_screen):
    async with run_screen(fake.snapshot()) as s:
        assert s.app.current_theme.dark
        await s.press("d")
        assert not s.app.current_theme.dark
        assert "Light" in s.answer()
        await s.press("d")
        assert s.app.current_theme.dark


async def test_help_opens_and_closes(run_screen):
    async with run_screen(fake.snapshot()) as s:
        for close in ("escape", "question_mark", "q", "enter"):
            await s.press("question_mark")
            assert isinstance(s.app.screen, HelpScreen)
            await s.press(close)
            assert isinstance(s.app.screen, MainScreen)
        assert s.source.calls == []


async def test_keys_of_the_main_screen_do_nothing_behind_the_help(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.press("question_mark", "r", "m", "R")
        assert s.source.calls == []


async def test_tab_goes_through_the_pages_and_back(run_screen):
    async with run_screen(fake.snapshot()) as s:
        seen = []
        for _ in PAGES:
            await s.press("tab")
            seen.append(s.app.get_default_screen().page)
        assert seen == ["plot", "vehicle", "events", "parameters"]
        await s.press("shift+tab")
        assert s.app.get_default_screen().page == "events"


async def test_numbers_choose_a_page(run_screen):
    shown = {"2": "95 % band", "3": "rotor 3", "4": "took off", "1": "unobservable  "}
    async with run_screen(fake.snapshot()) as s:
        for key, text in shown.items():
            await s.press(key)
            assert [text in s.text() for text in shown.values()].count(True) == 1
            assert text in s.text()


async def test_pages_are_for_small_terminals(run_screen):
    async with run_screen(fake.snapshot(), size=(120, 40)) as s:
        await s.press("tab")
        assert "All panels are on the screen" in s.answer()


async def test_page_keys_scroll_the_events(run_screen):
    many = tuple(Event(float(n), f"event number {n}") for n in range(200))
    async with run_screen(replace(fake.snapshot(), events=many)) as s:
        await s.press("4")
        assert "event number 199" in s.text()
        await s.press("pageup")
        assert not any("event number 199" in line for line in s.lines()[:-2])
        await s.press("pagedown")
        assert any("event number 199" in line for line in s.lines()[:-2])


async def test_a_click_chooses_a_parameter(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.pilot.click(offset=(5, 7))
        await s.settle()
        assert s.app.selected == "Ixy"


async def test_a_click_chooses_a_page(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.pilot.click(offset=(18, 1))
        await s.settle()
        assert s.app.get_default_screen().page == "plot"
        assert s.app.query_one(Convergence).display


async def test_the_command_palette_knows_the_actions(run_screen):
    async with run_screen(fake.snapshot()) as s:
        titles = {command.title for command in s.app.get_system_commands(s.app.screen)}
        assert {"Mark", "Reset", "Record", "Pause", "Dark/light", "Help", "Quit"} <= titles
        assert "Plot k_T" in titles
        await s.press("ctrl+p")
        assert isinstance(s.app.screen, CommandPalette)


async def test_a_command_of_the_palette_chooses_a_parameter(run_screen):
    async with run_screen(fake.snapshot()) as s:
        commands = {c.title: c.callback for c in s.app.get_system_commands(s.app.screen)}
        commands["Plot k_T"]()
        assert s.app.selected == "k_T"


async def test_what_a_source_cannot_do_is_said_in_plain_words(run_screen):
    async with run_screen(fake.snapshot(), actions=Actions(absent="in a replay")) as s:
        for key, what in {"m": "Mark", "r": "Reset", "R": "Record"}.items():
            await s.press(key)
            assert s.answer() == f"{what}: not in a replay."
        assert s.source.calls == []
