"""The page bar of small terminals: which of the panels is shown."""

from textual import events
from textual.content import Content
from textual.message import Message
from textual.widget import Widget

from gcs_sysid.screen import formatting as fmt

PAGES = {
    "parameters": "Parameters",
    "plot": "Plot",
    "motion": "Motion",
    "vehicle": "Vehicle",
    "events": "Events",
    "health": "Health",
}
"""Name of each page (and of its CSS class), and its title."""


class PageBar(Widget):
    """One line of page titles; a click or a number key chooses one."""

    class Chosen(Message):
        """The user clicked on a page."""

        def __init__(self, page: str) -> None:
            super().__init__()
            self.page = page

    def __init__(self) -> None:
        super().__init__(id="pages")
        self.page = next(iter(PAGES))

    def select(self, page: str) -> None:
        """Light up another title."""
        self.page = page
        self.refresh()

    def _titles(self) -> list[tuple[str, str]]:
        """Number and title of each; where all do not fit, only the selected page has its title."""
        numbered = list(enumerate(PAGES.items(), start=1))
        whole = [(name, f" {number} {title} ") for number, (name, title) in numbered]
        if sum(len(text) + 1 for _, text in whole) - 1 <= self.size.width:
            return whole
        return [
            (name, text if name == self.page else f" {number} ")
            for number, (name, text) in enumerate(whole, start=1)
        ]

    def render(self) -> Content:
        """The titles; brackets as well as color say which page it is."""
        parts: list[tuple[str, str]] = []
        for name, title in self._titles():
            on = name == self.page
            text = f"[{title[1:-1]}]" if on else title
            parts += [(text, "bold $text-primary on $primary-muted" if on else fmt.MUTED)]
            parts += [(" ", "")]
        return Content.assemble(*parts[:-1])

    def on_click(self, event: events.Click) -> None:
        """Find the title under the mouse."""
        x = 0
        for name, title in self._titles():
            if x <= event.x < x + len(title):
                self.post_message(self.Chosen(name))
                return
            x += len(title) + 1
