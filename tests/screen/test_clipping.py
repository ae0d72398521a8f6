"""Nothing of the screen is cut off or lies outside the terminal, whatever its size."""

import itertools
from dataclasses import replace

import pytest
from textual.containers import VerticalScroll
from textual.widgets._footer import FooterKey

from gcs_sysid.screen.widgets.lines import Lines

from . import fake

SOME = [(60, 20), (62, 24), (72, 80), (161, 40), (196, 36), (196, 40), (300, 80)]
ALL = [
    *((width, 24 + width % 3) for width in range(60, 301)),
    *((width, 50) for width in range(60, 301, 7)),
    *itertools.product((60, 80, 120, 196, 300), range(20, 81, 4)),
]


def scrolled(widget):
    return any(isinstance(above, VerticalScroll) for above in widget.ancestors)


def cut(app):
    """What is cut at the right edge, and what lies outside the terminal."""
    for lines in app.screen.query(Lines):
        if lines.is_on_screen:
            room = lines.content_size.width
            for line in lines.lines:
                text = "".join(part for part, _ in line).rstrip()
                if len(text) > room:
                    yield f"{lines.id}: {text!r} has {len(text)} columns of {room}"
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
