"""The coach: what to fly next, how far it is flown, and what it brings."""

from textual.content import Content
from textual.widgets import Static

from gcs_sysid.results.snapshot import Advice
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.snapshot_view import gain_text, seconds_left
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line


def advice_lines(advice: Advice, width: int) -> list[Line]:
    """The advice as lines: what to fly, then progress and gains."""
    if advice.enough:
        return [[("✓ ENOUGH  ", "bold $text-success"), (advice.text, "bold")]]
    if not advice.manoeuvre:
        return [[("COACH  ", "bold $text-primary"), (advice.text, "")]]
    parts: Line = [
        (fmt.bar(advice.progress, 20), "$text-primary on $panel"),
        (f" {100.0 * advice.progress:3.0f} %  {seconds_left(advice):.0f} s left", "bold"),
    ]
    room = width - sum(len(text) for text, _ in parts)
    for gain in advice.gains:
        text = f"   {gain_text(gain)}"
        room -= len(text)
        if room < 0:
            break
        parts.append((text, ""))
    return [[("▶ FLY  ", "bold $text-primary"), (advice.text, "bold")], parts]


class CoachPanel(Static):
    """Draws the advice of the snapshot; hidden while there is none."""

    def __init__(self) -> None:
        super().__init__(id="coach")
        self._shown: list[Line] = []
        self.display = False

    def show(self, view: View) -> None:
        """Bring the panel up to date."""
        advice = None if view.snapshot is None else view.snapshot.advice
        self.display = advice is not None
        if advice is None:
            return
        width = max(40, self.screen.size.width - 2)
        lines = advice_lines(advice, width)
        if lines != self._shown:
            texts = [
                ["".join(text for text, _ in line) for line in x] for x in (self._shown, lines)
            ]
            grown = fmt.wrapped(texts[0], width) != fmt.wrapped(texts[1], width)
            self._shown = lines
            content = Content("\n").join([Content.assemble(*line) for line in lines])
            self.update(content, layout=grown)
