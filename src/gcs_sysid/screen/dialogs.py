"""Questions over the main screen: one of a list, or a line of text."""

from collections.abc import Sequence
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.screen import ModalScreen
from textual.suggester import SuggestFromList
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option


class Choose(ModalScreen[str | None]):
    """One of a list: enter or a click takes it, escape gives None.

    Args:
        title: of the box.
        options: value and text of each.
        hint: a line below.
    """

    BINDINGS: ClassVar[list[BindingType]] = [("escape,q", "cancel", "Cancel")]

    def __init__(self, title: str, options: Sequence[tuple[str, str]], hint: str = "") -> None:
        super().__init__()
        self._title, self._hint = title, hint
        self._options = options

    def compose(self) -> ComposeResult:
        """One box in the middle."""
        with Vertical(classes="dialog") as box:
            box.border_title = self._title
            box.border_subtitle = "↑↓ enter · esc cancels"
            yield OptionList(*(Option(Content(text), id=value) for value, text in self._options))
            if self._hint:
                yield Static(Content(self._hint))

    @on(OptionList.OptionSelected)
    def take(self, event: OptionList.OptionSelected) -> None:
        """Answer with what was chosen."""
        self.dismiss(event.option.id)

    def action_cancel(self) -> None:
        """Answer with nothing."""
        self.dismiss(None)


class Enter(ModalScreen[str | None]):
    """A line of text: enter takes it, escape gives None.

    Args:
        title: of the box.
        hint: what to write, and what comes of it.
        value: that stands there already.
        suggestions: offered while one types; the right arrow takes one.
    """

    BINDINGS: ClassVar[list[BindingType]] = [("escape", "cancel", "Cancel")]

    def __init__(
        self, title: str, hint: str, value: str = "", suggestions: Sequence[str] = ()
    ) -> None:
        super().__init__()
        self._title, self._hint, self._value = title, hint, value
        self._suggestions = suggestions

    def compose(self) -> ComposeResult:
        """One box in the middle."""
        with Vertical(classes="dialog") as box:
            box.border_title = self._title
            box.border_subtitle = "enter · esc cancels"
            suggester = SuggestFromList(self._suggestions) if self._suggestions else None
            yield Input(self._value, suggester=suggester, compact=True)
            yield Static(Content(self._hint))

    @on(Input.Submitted)
    def take(self, event: Input.Submitted) -> None:
        """Answer with what was written."""
        self.dismiss(event.value.strip())

    def action_cancel(self) -> None:
        """Answer with nothing."""
        self.dismiss(None)
