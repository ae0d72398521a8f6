"""The screen on a fake session, and helpers to read what a terminal would show."""

from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest
from rich.segment import Segment
from textual._compositor import Compositor
from textual._context import visible_screen_stack
from textual.pilot import Pilot

from gcs_sysid.results.snapshot import LinkState, Snapshot
from gcs_sysid.screen import EarlierResult, Scene, SysidApp
from gcs_sysid.screen.app import ReplayApp

from . import fake


@pytest.fixture(autouse=True)
def terminal_output(monkeypatch: pytest.MonkeyPatch) -> None:
    """Updates are not drawn for a terminal that a test does not have: 40 % of its time. What would
    be on it is drawn where a test asks for it, whole; test_flow draws every update."""

    monkeypatch.setattr(Compositor, "render_update", lambda self, **_: self._dirty_regions.clear())


class Clock:
    """Seconds that pass only when a test says so."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Running:
    """The app under test with all that a test asks of it."""

    app: SysidApp
    pilot: Pilot[None]
    source: fake.FakeSource
    clock: Clock

    def segments(self) -> list[list[Segment]]:
        """What the terminal shows. Textual has no public way to ask for it but as SVG."""
        visible_screen_stack.set(self.app._background_screens)
        return [list(strip) for strip in self.app.screen._compositor.render_strips()]

    def lines(self) -> list[str]:
        return ["".join(s.text for s in line).rstrip() for line in self.segments()]

    def text(self) -> str:
        return "\n".join(self.lines()) + "\n"

    def answer(self) -> str:
        return self.app._main.answer.text

    async def press(self, *keys: str) -> None:
        await self.pilot.press(*keys)
        await self.pilot.pause()

    async def settle(self) -> None:
        """Let messages and the drawings they ask for go through."""
        await self.pilot.pause()
        await self.pilot.pause()

    async def worked(self) -> None:
        """Let what was started in a thread come to its end."""
        await self.app.workers.wait_for_complete()
        await self.settle()

    async def serve(self, snapshot: Snapshot | None) -> None:
        """Put another snapshot into the source and let the app see it."""
        self.source.snapshot = snapshot
        self.app.poll()
        await self.settle()


RunScreen = Callable[..., AbstractAsyncContextManager[Running]]


@pytest.fixture
def run_screen() -> RunScreen:
    """Start the app on a snapshot, in a terminal of a given size."""

    @asynccontextmanager
    async def run(
        first: Snapshot | None,
        size: tuple[int, int] = (80, 24),
        truth: Mapping[str, float] | None = fake.TRUTH,
        baseline: EarlierResult | None = None,
        replayed: bool = False,
    ) -> AsyncIterator[Running]:
        source, clock = fake.FakeSource(first), Clock()
        scene = Scene(
            truth or {}, source, None, source.export, fake.TARGETS, source.report, baseline
        )
        scene = Scene(replay=source) if replayed else scene
        app = SysidApp(source, scene, time_source=clock)
        async with app.run_test(size=size) as pilot:
            running = Running(app, pilot, source, clock)
            await running.settle()
            yield running

    return run


@pytest.fixture
def run_replay():
    """The same for a replay; also gives what was asked of it."""

    @asynccontextmanager
    async def run(playback=fake.PLAYING, size=(80, 24)):
        link = fake.link(LinkState.REPLAY, url="flight.ulg", recording="")
        source = fake.FakeSource(replace(fake.snapshot(), link=link, playback=playback))
        clock, asked = Clock(), []

        def noted(what):
            return lambda *arguments: (asked.append((what, *arguments)), f"{what} it is")[1]

        names = {"toggle_pause": "pause", "change_speed": "speed", "seek": "seek", "skip": "skip"}
        replay = SimpleNamespace(**{name: noted(what) for name, what in names.items()})
        scene = Scene(fake.TRUTH, replay=replay)
        app = ReplayApp(source, scene, time_source=clock)
        async with app.run_test(size=size) as pilot:
            running = Running(app, pilot, source, clock)
            await running.settle()
            yield running, asked

    return run
