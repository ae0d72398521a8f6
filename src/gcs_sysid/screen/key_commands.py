"""What the keys of the screen do, once for bindings, footer, help and command palette."""

from collections.abc import Sequence
from dataclasses import dataclass

from textual.binding import Binding


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
