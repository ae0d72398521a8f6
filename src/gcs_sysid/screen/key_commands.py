"""What the keys of the screen do, once for bindings, footer, help and command palette.

And what they open over the main screen: a list to choose from, a line to enter, the help.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.suggester import SuggestFromList
from textual.widget import Widget
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option

from gcs_sysid.results.words import CHANGE, STATUS
from gcs_sysid.screen import formatting as fmt


@dataclass(frozen=True)
class KeyCommand:
    """Something that keys do.

    Attributes:
        meaning: in a few words.
        bindings: keys as Textual names them, and the application's action, for each.
        keys: as people write them; empty: the one key.
        title: in the command palette; empty: not there.
        footer: its word there; empty: not there.
    """

    meaning: str
    bindings: tuple[tuple[str, str], ...] = ()
    keys: str = ""
    title: str = ""
    footer: str = ""

    @property
    def written(self) -> str:
        """The keys, for people."""
        return self.keys or self.bindings[0][0]


PAGES = {
    "parameters": "Parameters",
    "plot": "Plot",
    "motion": "Motion",
    "vehicle": "Vehicle",
    "events": "Events",
    "health": "Health",
}
"""Name of each page (and of its CSS class), and its title."""


def _one(key: str, action: str, title: str, meaning: str, footer: str = "") -> KeyCommand:
    return KeyCommand(meaning, ((key, action),), key[0], title, footer)


COMMANDS = (
    KeyCommand(
        "choose the parameter in the plot (or click on it)",
        (("down,j", "select(1)"), ("up,k", "select(-1)")),
        "↑ ↓  j k",
    ),
    KeyCommand(
        "next page or plot; 6: health",
        (
            ("tab", "page(1)"),
            ("shift+tab", "page(-1)"),
            *((str(n), f"go('{page}')") for n, page in enumerate(PAGES, start=1)),
        ),
        "tab  1-6",
    ),
    _one("m", "mark", "Mark", "mark this instant in the event log", "Mark"),
    # With shift too: no slip turns a harmless key into this one, and it asks first.
    _one("r,R", "reset", "Reset", "reset: discard the data so far; asks first", "Reset"),
    _one("l", "pilot_view", "Pilot view", "pilot view: the coach in large print", "Large"),
    _one("a", "call_outs", "Call-outs", "call-outs: off, voice, bell"),
    _one("o", "record", "Record", "start or stop recording", "Record"),
    _one("p", "pause", "Pause", "pause the display; identification continues", "Pause"),
    _one("e", "export", "Export", "export the values for a simulator, into a new file", "Export"),
    _one("h", "report", "Report", "report of the flight so far (HTML), into a new file", "Report"),
    _one("s", "scale", "Scale", "scale: enter mass or rotor thrust", "Scale"),
    _one("b", "baseline", "Baseline", "compare with an earlier result"),
    _one("v", "vehicle", "Vehicle", "choose the vehicle, if there are several"),
    _one("d", "toggle_dark", "Dark/light", "dark or light"),
    KeyCommand(
        "scroll the events",
        (("pageup", "scroll_events(-1)"), ("pagedown", "scroll_events(1)")),
        "pgup pgdn",
    ),
    KeyCommand(
        "command palette, this help, quit",
        (("question_mark", "help"),),
        "ctrl+p  ? q",
        "Help",
        "Help",
    ),
)
STEP, LEAP = 10.0, 60.0
"""s that a key of a replay goes on or back, and with shift."""
REPLAY_COMMANDS = (
    KeyCommand("pause or resume the replay", (("space", "pause"),), "space  p"),
    KeyCommand(
        f"{STEP:.0f} s back or on; with shift {LEAP:.0f} s",
        (
            ("left", f"skip(-{STEP})"),
            ("right", f"skip({STEP})"),
            ("shift+left", f"skip(-{LEAP})"),
            ("shift+right", f"skip({LEAP})"),
        ),
        "← →",
    ),
    KeyCommand(
        "to the beginning, to the end (or click on the bar)",
        (("home", "seek(0.0)"), ("end", "to_end")),
        "home end",
    ),
    KeyCommand(
        "slower, faster: 1x, 10x, max",
        (
            ("left_square_bracket,minus", "speed(-1)"),
            ("right_square_bracket,plus,equals_sign", "speed(1)"),
        ),
        "[ ]  - +",
    ),
)


def bindings_of(commands: Sequence[KeyCommand]) -> list[Binding]:
    """The bindings of commands, those with a word in the footer shown there."""
    return [
        Binding(
            keys,
            f"app.{action}",
            command.footer or command.meaning,
            show=bool(command.footer),
            key_display="?" if keys == "question_mark" else keys[0] if "," in keys else None,
        )
        for command in commands
        for keys, action in command.bindings
    ]


class Dialog(ModalScreen[str | None]):
    """A question in a box; escape gives None."""

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

    Of each option, value and text.
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

    `suggestions` are offered while one types; the right arrow takes one.
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

    `ended`: the flight is over, so that there is nothing more to fly.
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
    """Help over the main screen; any of its keys closes it."""

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
