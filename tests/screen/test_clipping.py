"""Nothing of the screen is cut off or lies outside the terminal, whatever its size."""

import itertools
from dataclasses import replace

import pytest
from textual.containers import VerticalScroll
from textual.widgets._footer import FooterKey

from gcs_sysid.results.snapshot import Advice, LinkState
from gcs_sysid.screen.bars import VerdictPanel, verdict_lines
from gcs_sysid.screen.lines import Lines
from gcs_sysid.screen.main_view import PAGES, PageBar
from gcs_sysid.screen.snapshot_view import headline

from . import fake

SOME = [(60, 20), (62, 24), (72, 80), (161, 40), (196, 36), (196, 40), (300, 80)]
ALL = [
    *((width, 24 + width % 3) for width in range(60, 301)),
    *((width, 50) for width in range(60, 301, 7)),
    *itertools.product((60, 80, 120, 196, 300), range(20, 81, 4)),
]


def scrolled(widget):
    return any(isinstance(above, VerticalScroll) for above in widget.ancestors)


def too_long(lines, room):
    """The lines of a widget that wraps which have not room on one row."""
    for line in lines:
        text = "".join(part for part, _ in line).rstrip()
        if len(text) > room:
            yield f"{text!r} has {len(text)} columns of {room}"


def cut(app):
    """What is cut at the right edge, and what lies outside the terminal."""
    for lines in app.screen.query(Lines):
        if lines.is_on_screen:
            room = lines.content_size.width
            yield from (f"{lines.id}: {wrong}" for wrong in too_long(lines.lines, room))
    for panel in app.screen.query(VerdictPanel):
        if panel.is_on_screen:
            room = panel.content_size.width
            yield from (f"{panel.id}: {wrong}" for wrong in too_long(panel.lines, room))
    for pages in app.screen.query(PageBar):
        if pages.is_on_screen:
            text, room = pages.render().plain, pages.content_size.width
            if len(text) > room:
                yield f"pages: {text!r} has {len(text)} columns of {room}"
    for widget in app.screen.walk_children():
        # The footer names as many keys as it has room for; ? names all.
        if isinstance(widget, FooterKey) or not widget.is_on_screen or scrolled(widget):
            continue
        if widget.region.area and not app.screen.region.contains_region(widget.region):
            yield f"{widget.id}: {widget.region} is outside"


@pytest.mark.slow
@pytest.mark.parametrize(
    "sizes", [SOME, pytest.param(ALL, marks=pytest.mark.thorough)], ids=["some", "all"]
)
async def test_nothing_is_clipped(run_screen, sizes):
    snapshot = replace(fake.snapshot(), advice=fake.advice())
    found = {}
    async with run_screen(snapshot, size=(80, 24), truth=fake.TRUTH) as s:
        for size in sizes:
            await s.pilot.resize_terminal(*size)
            await s.settle()
            if wrong := list(cut(s.app)):
                found[size] = wrong
    assert found == {}


def headlined():
    """Every headline, by its words."""
    shot = fake.snapshot()
    good = {
        name: estimate if estimate.status == "given" else replace(
            estimate, std=0.008 * abs(estimate.value), status="identified"
        )
        for name, estimate in fake.estimates().items()
        if estimate.value
    }  # fmt: skip
    whole = replace(shot, result=replace(fake.result(), verdict="identified", parameters=good))
    wide = dict(good, Izz=replace(good["Izz"], std=0.0104 * good["Izz"].value))
    above = replace(shot, result=replace(whole.result, parameters=wide))
    ended = replace(fake.bare(), link=fake.link(LinkState.ENDED))
    made = (
        shot,
        whole,
        above,
        replace(whole, advice=Advice("", "land when you like", enough=True)),
        fake.bare(),
        replace(fake.bare(), used_seconds=20.0),
        ended,
    )
    return {headline(snapshot): snapshot for snapshot in made}


HEADLINED = headlined()


def test_every_headline_is_tried():
    assert set(HEADLINED) == {
        "PARTIAL", "IDENTIFIED", "IDENTIFIED TO ±2.1 %", "ENOUGH", "WAITING", "NOT YET",
        "NO ANSWER",
    }  # fmt: skip


@pytest.mark.parametrize("words", HEADLINED)
@pytest.mark.parametrize("target", [None, 0.0125])
def test_no_headline_wraps(words, target):
    snapshot = HEADLINED[words]
    snapshot = snapshot if target is None else replace(snapshot, target=target)
    found = {}
    for width in range(58, 299):
        small = verdict_lines(snapshot, width, large=False)
        large = verdict_lines(snapshot, width, large=True)
        assert len(small) == 1
        if wrong := [*too_long(small, width), *too_long(large, width)]:
            found[width] = wrong
        if width >= 116:  # where panels are side by side
            assert len(large) == 3, width
    assert found == {}


async def test_the_page_bar_is_whole_at_any_width(run_screen):
    """Below 68 columns only the selected page has its title; a click finds the page."""
    async with run_screen(fake.snapshot(), size=(60, 24)) as s:
        bar = s.app.screen.query_one(PageBar)
        for width in (67, 68):
            await s.pilot.resize_terminal(width, 24)
            await s.settle()
            assert list(cut(s.app)) == []
            text = bar.render().plain
            assert "[1 Parameters]" in text
            assert all(f"{number}" in text for number in range(1, len(PAGES) + 1))
            assert ("6 Health" in text) is (width >= 68)
        await s.pilot.resize_terminal(60, 24)
        await s.settle()
        await s.pilot.click(PageBar, offset=(bar.render().plain.index("6"), 0))
        await s.settle()
        assert "[6 Health]" in bar.render().plain
