"""Every key, through Textual's Pilot: what the source is told and what the screen answers."""

import threading
from dataclasses import replace

import pytest
from textual.command import CommandPalette

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.snapshot import Event, LinkState
from gcs_sysid.screen import EarlierResult
from gcs_sysid.screen.key_commands import Choose, HelpScreen
from gcs_sysid.screen.main_view import PAGES, MainScreen
from gcs_sysid.screen.plots import Convergence

from . import fake


@pytest.mark.parametrize("key", ["q", "ctrl+c", "ctrl+q"])
async def test_quit_stops_the_session_and_asks_nothing(run_screen, key):
    async with run_screen(fake.snapshot()) as s:
        await s.pilot.press(key)
        await s.pilot.pause()
        assert s.source.calls == ["stop"]
        assert not s.app.is_running


async def test_select_moves_through_the_parameters_and_around(run_screen):
    async with run_screen(fake.snapshot()) as s:
        assert s.app.selected == "Ixx"  # the first that is not given
        for down, up in (("down", "up"), ("j", "k")):
            await s.press(down)
            assert s.app.selected == "Iyy"
            assert "Iyy" in s.answer()
            assert any(line.startswith("▸Iyy") for line in s.lines())
            await s.press(up, up, up)
            assert s.app.selected == "rotor_delay"
            await s.press(down, down)


@pytest.mark.slow
async def test_reset_asks_and_no_slip_of_shift_leads_there(run_screen):
    """No other key is one Shift or Ctrl apart from it, and with Shift it asks all the same."""
    async with run_screen(fake.snapshot()) as s:
        keys = {key for key, *_ in s.app.screen.active_bindings.items()}
        assert {"r", "R"} <= keys
        assert "ctrl+r" not in keys
        for key in "rR":
            await s.press(key, "enter")
            assert s.source.calls == []
            assert s.answer() == "Reset: cancelled."
        await s.press("r", "escape")
        assert s.source.calls == []
        await s.press("r", "down", "enter")
        assert s.source.calls == ["reset"]
        assert s.answer() == "Reset: the estimate restarts."


async def test_marks_are_numbered_and_a_recording_goes_on_in_another_file(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.press("m", "m")
        assert s.source.calls == ["mark 'mark 1'", "mark 'mark 2'"]
        await s.serve(s.source.snapshot)  # the marks are events, too
        await s.press("o")
        assert s.source.calls[2:] == ["record"]
        assert s.answer() == "recording stopped"
        await s.press("o")
        assert s.answer() == "recording to logs/next.tlog"
        await s.press("5")
        assert sum("mark " in line for line in s.lines()[2:-2]) == 2


@pytest.mark.slow
async def test_a_failed_action_says_why_and_the_screen_lives(run_screen):
    async with run_screen(fake.snapshot()) as s:
        s.source.broken = True
        for keys in (("m",), ("r", "down", "enter"), ("o",)):
            await s.press(*keys)
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
        assert "resumed" in s.answer()
        assert s.source.calls == []


@pytest.mark.slow
async def test_it_is_dark_or_light_and_help_opens_and_closes(run_screen):
    async with run_screen(fake.snapshot()) as s:
        assert s.app.current_theme.dark
        await s.press("d")
        assert not s.app.current_theme.dark
        assert "Light" in s.answer()
        await s.press("d")
        assert s.app.current_theme.dark
        for close in ("escape", "question_mark", "q", "enter"):
            await s.press("question_mark")
            assert isinstance(s.app.screen, HelpScreen)
            await s.press(close)
            assert isinstance(s.app.screen, MainScreen)
        assert s.source.calls == []


@pytest.mark.slow
async def test_tab_goes_through_the_pages_and_back(run_screen):
    async with run_screen(fake.snapshot()) as s:
        seen = []
        for _ in PAGES:
            await s.press("tab")
            seen.append(s.app.get_default_screen().page)
        assert seen == ["plot", "motion", "vehicle", "events", "health", "parameters"]
        await s.press("shift+tab")
        assert s.app.get_default_screen().page == "health"


@pytest.mark.slow
async def test_where_the_panels_have_room_pages_choose_the_plot(run_screen):
    async with run_screen(fake.snapshot(), size=(120, 40)) as s:
        assert "95 % band" in s.text()
        await s.press("tab")
        assert "• predicted" in s.text()
        assert "95 % band" not in s.text()
        await s.press("tab")
        assert "thrust drift" in s.text()
        assert "• predicted" not in s.text()
        await s.press("2")
        assert "95 % band" in s.text()
        await s.press("4")
        assert s.answer() == "Vehicle: is on the screen."


async def test_page_keys_scroll_the_events(run_screen):
    many = tuple(Event(float(n), f"event number {n}") for n in range(200))
    async with run_screen(replace(fake.snapshot(), events=many)) as s:
        await s.press("5")
        assert "event number 199" in s.text()
        await s.press("pageup")
        assert not any("event number 199" in line for line in s.lines()[:-2])
        await s.press("pagedown")
        assert any("event number 199" in line for line in s.lines()[:-2])


async def test_the_events_are_followed_at_every_size(run_screen):
    async with run_screen(fake.snapshot(), size=(140, 45)) as s:
        for count in range(1, 60):
            many = tuple(Event(float(n), f"event number {n}") for n in range(count))
            s.source.snapshot = replace(fake.snapshot(), events=many)
            s.app.poll()
        await s.settle()
        assert any("event number 58" in line for line in s.lines()[:-2])
        # A notice above takes a line of the panel.
        lost = replace(fake.snapshot(), link=fake.link(LinkState.LOST), events=many)
        await s.serve(lost)
        await s.serve(replace(lost, events=(*many, Event(60.0, "event number 59"))))
        assert any("event number 59" in line for line in s.lines()[:-2])


async def test_a_click_chooses_a_parameter_or_a_page(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.pilot.click(offset=(5, 8))
        await s.settle()
        assert s.app.selected == "Ixy"
        await s.pilot.click(offset=(18, 2))
        await s.settle()
        assert s.app.get_default_screen().page == "plot"
        assert s.app.query_one(Convergence).display


async def test_the_command_palette_knows_the_actions(run_screen):
    async with run_screen(fake.snapshot()) as s:
        titles = {command.title for command in s.app.get_system_commands(s.app.screen)}
        assert {"Mark", "Reset", "Record", "Pause", "Export", "Report", "Scale"} <= titles
        assert {"Baseline", "Vehicle", "Dark/light", "Help", "Quit", "Page Motion"} <= titles
        assert "Plot k_T" in titles
        await s.press("ctrl+p")
        assert isinstance(s.app.screen, CommandPalette)


@pytest.mark.slow
async def test_what_a_source_cannot_do_is_said_in_plain_words(run_screen):
    async with run_screen(fake.snapshot(), replayed=True) as s:
        words = {"m": "Mark", "r": "Reset", "o": "Record", "e": "Export", "h": "Report"}
        for key, what in {**words, "s": "Scale", "v": "Vehicle"}.items():
            await s.press(key)
            assert s.answer() == f"{what}: not in a replay."
        assert s.source.calls == []


@pytest.mark.slow
async def test_export_asks_for_the_format_and_says_where(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.press("e")
        assert isinstance(s.app.screen, Choose)
        assert "gazebo-sdf" in s.text()
        await s.press("down", "enter")
        await s.worked()
        assert s.source.calls == ["export gazebo-sdf partial"]
        assert s.answer() == "written: paper.gazebo-sdf"


@pytest.mark.slow
async def test_escape_leaves_everything_as_it_was(run_screen):
    async with run_screen(fake.snapshot()) as s:
        for keys in ("e", "s", "b", "bmrq"):  # what is typed into a question does nothing else
            await s.press("d", "d", *keys, "escape")
            assert isinstance(s.app.screen, MainScreen)
            assert s.source.calls == []
            assert "unchanged" in s.answer() or "nothing written" in s.answer()
        assert s.app.is_running


async def test_report_is_made_beside_and_said_at_its_end(run_screen):
    async with run_screen(fake.snapshot()) as s:
        going, done = threading.Event(), threading.Event()

        def slow():
            going.set()
            assert done.wait(20.0)
            return "written: flight.html"

        s.app.scene = replace(s.app.scene, report=slow)
        await s.press("h")
        assert s.answer() == "Report: working ..."
        assert going.wait(20.0)
        await s.press("j")  # keys are answered meanwhile
        assert "Plot" in s.answer()
        await s.press("h")
        assert s.answer() == "Report: the last one is not finished."
        done.set()
        await s.worked()
        assert s.answer() == "written: flight.html"


@pytest.mark.slow
async def test_scale_asks_which_fact_then_its_value(run_screen):
    async with run_screen(fake.snapshot()) as s:
        await s.press("s")
        assert "Now: mass 1.5" in s.text()
        assert "T_max" not in s.text()  # there are rotor speeds
        await s.press("enter", "end", "x", "enter")
        assert s.answer() == "Not done: '1.5x' is not a number (kg wanted)"
        await s.press("s", "enter", "escape")
        assert s.answer() == "Scale unchanged."
        assert s.source.calls == []
        await s.press("s", "enter")
        assert "1.5" in s.text()  # the present value stands there already
        await s.press("end", "backspace", "6", "enter")
        assert s.source.calls == ["anchor mass 1.6"]
        assert s.answer() == "scale from mass = 1.6"
        await s.press("s", "down", "enter", "enter")
        assert s.source.calls[-1].startswith("anchor k_T 0.000205")


async def test_scale_with_commands_offers_the_full_thrust(run_screen):
    result = replace(fake.result(), rotor_input=RotorInput.COMMAND)
    async with run_screen(replace(fake.snapshot(), result=result)) as s:
        await s.press("s")
        assert "T_max" in s.text()
        assert "thrust over speed squared" not in s.text()


@pytest.mark.slow
async def test_the_vehicle_is_chosen_from_those_that_speak(run_screen):
    async with run_screen(fake.two_vehicles()) as s:
        assert "v: 2 vehicles" in s.text()
        await s.press("v")
        assert "● PX4 quadrotor 1:1" in s.text()
        await s.press("enter")
        assert s.answer() == "Vehicle unchanged."
        await s.press("v", "down", "enter")
        assert s.source.calls == ["vehicle 2:1"]
        assert s.answer() == "restarting on ArduPilot quadrotor 2:1"


@pytest.mark.slow
async def test_a_baseline_is_loaded_compared_and_dropped(run_screen, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.json").write_text(fake.earlier().dumps(), encoding="utf-8")
    async with run_screen(fake.snapshot()) as s:
        await s.press("b", *"a.json", "enter")
        assert s.answer().startswith("Compared with a.json: partial, from logs/")
        assert "≠ against a.json: changed: Ixx" in s.text()
        ixx = next(line for line in s.lines() if line.startswith("▸Ixx"))
        assert ixx.endswith("≠  +20 %")
        assert any(line.startswith(" Iyy") and line.endswith("= +0.0 %") for line in s.lines())
        await s.press("b", *["backspace"] * 6, "enter")
        assert s.answer() == "Baseline removed."
        assert "against" not in s.text()


async def test_a_baseline_of_another_vehicle_is_dropped_with_a_word(run_screen):
    four, six = (load_airframe(name).as_json() for name in ("px4-quad-x", "px4-hexa-x"))
    baseline = EarlierResult("six.json", replace(fake.earlier(), airframe=six))
    snapshot = replace(fake.snapshot(), result=replace(fake.result(), airframe=four))
    async with run_screen(snapshot, baseline=baseline) as s:
        assert s.answer().startswith("Baseline removed: ")
        assert s.answer().endswith("not the same vehicle")
        assert s.app.baseline is None


async def test_a_defect_beside_does_not_end_the_session(run_screen):
    async with run_screen(fake.snapshot()) as s:
        s.app.scene = replace(s.app.scene, report=lambda: str(1 // 0))
        await s.press("h")
        for _ in range(100):
            await s.pilot.pause(0.02)
            if "internal error" in s.answer():
                break
        assert s.answer().startswith("Report: internal error (ZeroDivisionError")
        assert s.app.is_running
        await s.press("j")
        assert "Plot" in s.answer()
