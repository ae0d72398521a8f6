"""What opens over the main screen: a list to choose from, a line to enter, the help."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.suggester import SuggestFromList
from textual.widget import Widget
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option

from gcs_sysid.results.words import CHANGE, STATUS
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.key_commands import COMMANDS, KeyCommand


class Dialog(ModalScreen[str | None]):
    """A question in a box; escape gives None.

    Args:
        title: of the box.
        keys: that answer it.
        hint: a line below.
    """

    BINDINGS: ClassVar[list[BindingType]] = [("escape", "cancel", "Cancel")]

    def __init__(self, title: str, keys: str, hint: str) -> None:
        super().__init__()
        self._title, self._keys, self._hint = title, keys, hint

    @abstractmethod
    def control(self) -> Widget:
        """What is answered with."""

    def compose(self) -> ComposeResult:
        """One box in the middle."""
        with Vertical(classes="dialog") as box:
            box.border_title = self._title
            box.border_subtitle = f"{self._keys} · esc cancels"
            yield self.control()
            if self._hint:
                yield Static(Content(self._hint))

    def action_cancel(self) -> None:
        """Answer with nothing."""
        self.dismiss(None)


class Choose(Dialog):
    """One of a list: enter or a click takes it.

    Args:
        title: of the box.
        options: value and text of each.
        hint: a line below.
    """

    BINDINGS: ClassVar[list[BindingType]] = [("q", "cancel", "Cancel")]

    def __init__(self, title: str, options: Sequence[tuple[str, str]], hint: str = "") -> None:
        super().__init__(title, "↑↓ enter", hint)
        self._options = options

    def control(self) -> Widget:
        """The list."""
        return OptionList(*(Option(Content(text), id=value) for value, text in self._options))

    @on(OptionList.OptionSelected)
    def answer(self, event: OptionList.OptionSelected) -> None:
        """Answer with what was chosen."""
        self.dismiss(event.option.id)


class Enter(Dialog):
    """A line of text: enter takes it.

    Args:
        title: of the box.
        hint: what to write, and what comes of it.
        value: that stands there already.
        suggestions: offered while one types; the right arrow takes one.
    """

    def __init__(
        self, title: str, hint: str, value: str = "", suggestions: Sequence[str] = ()
    ) -> None:
        super().__init__(title, "enter", hint)
        self._value, self._suggestions = value, suggestions

    def control(self) -> Widget:
        """The line."""
        suggester = SuggestFromList(self._suggestions) if self._suggestions else None
        return Input(self._value, suggester=suggester, compact=True)

    @on(Input.Submitted)
    def answer(self, event: Input.Submitted) -> None:
        """Answer with what was written."""
        self.dismiss(event.value.strip())


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
