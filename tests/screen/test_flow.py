"""What the screen makes of snapshots: states of the link, changes, sizes."""

import itertools
from dataclasses import replace

import pytest

from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.snapshot import Event, LinkState
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.key_commands import help_text
from gcs_sysid.screen.panels import ParameterRows

from . import fake


@pytest.fixture(autouse=True)
def terminal_output():
    """Every update is drawn here, as in a terminal."""


def names_of(result):
    """Of the parameters, from top to bottom."""
    return [parameter.name for parameter, _ in fmt.rows(result)]


async def test_before_the_first_snapshot(run_screen):
    async with run_screen(None) as s:
        assert "Opening the link" in s.text()
        await s.serve(fake.snapshot())
        assert "Opening the link" not in s.text()
        assert "identified" in s.text()


async def test_a_lost_link_counts_the_silence(run_screen):
    async with run_screen(fake.snapshot()) as s:
        s.clock.now += 7.0
        await s.serve(replace(fake.snapshot(), link=fake.link(LinkState.LOST)))
        assert "no data for 7 s" in s.text()
        s.clock.now += 60.0
        s.app.poll()  # the same snapshot: nothing arrives, but time passes
        await s.settle()
        assert "no data for 1 min 7 s" in s.text()
        await s.serve(replace(fake.snapshot(), link=fake.link(received=20_000)))
        assert "silent" not in s.text()


async def test_the_parameter_under_the_mouse_is_explained(run_screen):
    async with run_screen(fake.snapshot()) as s:
        rows = s.app.screen.query_one(ParameterRows)
        names = names_of(fake.result())
        await s.pilot.hover(ParameterRows, offset=(3, names.index("Izz")))
        assert "body z axis" in str(rows.tooltip)
        await s.pilot.hover(ParameterRows, offset=(3, names.index("cg_x")))
        assert "forward" in str(rows.tooltip)


async def test_parameters_come_and_go(run_screen):
    """A vehicle that turns out to have no rotor speeds: other parameters, in their order."""
    async with run_screen(fake.snapshot()) as s:
        result = fake.result()
        found = dict(result.parameters)
        del found["k_T"], found["k_M"]
        found["T_max"] = Estimate(7.2, 0.1, "N", "identified")
        await s.serve(replace(fake.snapshot(), result=replace(result, parameters=found)))
        names = [line[1:14].strip() for line in s.lines()]
        assert "k_T" not in names
        assert names.index("cg_y") < names.index("T_max") < names.index("moment_ratio")
        await s.serve(fake.snapshot())
        names = [line[1:14].strip() for line in s.lines()]
        assert "T_max" not in names
        assert names.index("cg_y") + 1 == names.index("k_T")


async def test_a_new_event_reaches_the_line_above_the_footer_and_is_no_markup(run_screen):
    text = "param [red]X[/] set [/bold] [0]"
    async with run_screen(fake.snapshot()) as s:
        events = (*fake.snapshot().events, Event(41.0, text))
        await s.serve(replace(fake.snapshot(), events=events))
        assert s.answer() == text
        assert text in s.text()
        await s.press("5")
        assert s.text().count(text) == 1


@pytest.mark.slow
async def test_a_terminal_that_grows_and_shrinks(run_screen):
    async with run_screen(fake.snapshot(), size=(80, 24)) as s:
        sizes = [(200, 50), (20, 5), (120, 40), (1, 1), (80, 10), (100, 60), (240, 70), (80, 24)]
        before = s.text()
        for size, page in zip(sizes, itertools.cycle("12345"), strict=False):
            await s.press(page)
            await s.pilot.resize_terminal(*size)
            await s.settle()
        await s.press("1")
        assert s.lines()[2:-2] == before.split("\n")[2:-3]


async def test_a_bar_is_full_at_the_target(run_screen):
    def bar(s, name):
        line = next(line for line in s.lines() if line.lstrip("│▸ ").startswith(name))
        return line[65:80].count("█")

    async with run_screen(fake.snapshot()) as s:
        for size in ((80, 24), (120, 40), (200, 50)):
            await s.pilot.resize_terminal(*size)
            await s.serve(fake.snapshot())
            assert bar(s, "Iyy") == 7  # ±0.6 %, the target being 2 %
            assert 3 <= bar(s, "Izz") <= 5
            assert bar(s, "k_M") == 0
            await s.serve(replace(fake.snapshot(), target=0.001))
            assert 4 <= bar(s, "Iyy") <= 6


@pytest.mark.slow
async def test_the_final_plot_is_drawn_though_it_came_soon_after_the_last(run_screen):
    """Drawings of the plot are rationed; the last one must not be lost."""
    async with run_screen(fake.snapshot()) as s:
        await s.press("2")
        await s.serve(replace(fake.snapshot(), history=fake.history(90.0)))
        for _ in range(50):
            await s.pilot.pause(0.05)
            if "80" in s.lines()[-4]:
                break
        assert "80" in s.lines()[-4]


async def test_before_data_rows_wait_and_none_is_red(run_screen):
    async with run_screen(fake.bare()) as s:
        assert "○ WAITING 0/" in s.text()
        assert "○ waiting" in s.text()
        assert "✗" not in s.text()
        verdict = s.app.screen.query_one("#verdict")
        assert verdict.has_class("-waiting")
        assert not verdict.has_class("-refused")
        waiting = verdict.styles.background
        await s.serve(replace(fake.bare(), used_seconds=20.0))
        assert "✗ NOT YET 0/" in s.text()
        assert verdict.has_class("-refused")
        assert verdict.styles.background != waiting


async def test_after_the_end_nothing_is_to_come(run_screen):
    """No `yet`, and no advice on what to fly."""
    empty = fake.bare().history
    flying = replace(fake.snapshot(), history=empty)
    lost = replace(flying, link=fake.link(LinkState.LOST))
    async with run_screen(lost) as s:
        await s.press("2")
        assert "no history yet" in s.text()
        await s.serve(replace(flying, link=fake.link(LinkState.ENDED, recording="")))
        assert "no history" in s.text()
        assert "yet" not in s.text()
        await s.press("question_mark")
        assert "fly more" not in s.text()
    assert "fly more of its motion" in help_text().plain
