"""What opens over the main screen: a list to choose from, a line to enter, the help."""

from collections.abc import Sequence
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.suggester import SuggestFromList
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option

from gcs_sysid.results.words import CHANGE, STATUS
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.key_commands import COMMANDS, KeyCommand


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
    def answer(self, event: OptionList.OptionSelected) -> None:
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
    def answer(self, event: Input.Submitted) -> None:
        """Answer with what was written."""
        self.dismiss(event.value.strip())

    def action_cancel(self) -> None:
        """Answer with nothing."""
        self.dismiss(None)


def help_text(commands: Sequence[KeyCommand] = COMMANDS, *, ended: bool = False) -> Content:
    """The whole help.

    Args:
        commands: what keys do.
        ended: whether the flight is over, so that there is nothing more to fly.
    """
    parts: list[str | tuple[str, str]] = [("Keys\n", "bold underline")]
    for command in commands:
        parts += [(f"{command.written:<11}", "bold $text-primary"), f" {command.meaning}\n"]
    parts.append(("Status\n", "bold underline"))
    for status, word in STATUS.items():
        style = fmt.STATUS_STYLE[status]
        meaning = word.meaning if ended else word.with_advice
        parts += [(f"{word.sign} {status:<13}", f"bold {style}"), f" {meaning}\n"]
    parts.append("± is half the 95 % interval; the bar is full at the target.\n")
    changes = ", ".join(f"{word.sign} {word.meaning}" for word in CHANGE.values())
    parts.append(f"Change: {changes}.")
    return Content.assemble(*parts)


class HelpScreen(ModalScreen[None]):
    """Help over the main screen; any of its keys closes it.

    Args:
        commands: what keys do.
        ended: whether the flight is over.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        ("escape,question_mark,q,enter,space", "dismiss", "Close help"),
    ]

    def __init__(self, commands: Sequence[KeyCommand] = COMMANDS, *, ended: bool = False) -> None:
        super().__init__()
        self._commands, self._ended = commands, ended

    def compose(self) -> ComposeResult:
        """One box in the middle."""
        with VerticalScroll(id="help-box") as box:
            box.border_title = "Help"
            box.border_subtitle = "esc closes"
            yield Static(help_text(self._commands, ended=self._ended))

    def on_click(self) -> None:
        """A click anywhere closes it too."""
        self.dismiss()
