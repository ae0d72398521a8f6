"""The verdict: what is identified, how well, and what is not. To be read from two meters."""

from textual.content import Content
from textual.widgets import Static

from gcs_sysid.results import words
from gcs_sysid.results.snapshot import LinkState, Snapshot
from gcs_sysid.screen.big_letters import HEIGHT, big
from gcs_sysid.screen.verdict_summary import Standing, compared, headline, named, standing_of
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line

_TITLE = len("✗ unobservable")


class VerdictPanel(Static):
    """One line on a small terminal, large letters with three lines beside them on others."""

    LEVELS = ("identified", "partial", "refused")

    def __init__(self) -> None:
        super().__init__(id="verdict")
        self.large = False
        self._view: View | None = None
        self._shown: list[Line] = []
        self.display = False

    def show(self, view: View) -> None:
        """Bring the panel up to date."""
        self._view = view
        snapshot = view.snapshot
        self.display = snapshot is not None and snapshot.link.state is not LinkState.WAITING
        if snapshot is None or not self.display:
            return
        for level in self.LEVELS:
            self.set_class(level == snapshot.result.verdict, f"-{level}")
        width = max(40, self.screen.size.width - 2)
        standing = standing_of(snapshot)
        make = self._large if self.large else self._small
        lines = make(snapshot, standing, width)
        if view.comparison is not None:
            name = f"against {view.baseline}"
            sign, text = compared(view.comparison, width - len(name) - 4)
            lines.append([(f"{sign} ", "bold"), (f"{name}: ", ""), (text, "bold")])
        if lines != self._shown:
            grown = len(lines) != len(self._shown)
            self._shown = lines
            text_lines = [Content.assemble(*line) for line in lines]
            self.update(Content("\n").join(text_lines), layout=grown)

    def on_resize(self) -> None:
        """Lay out the lines again."""
        if self._view is not None:
            self.show(self._view)

    def _absent(self) -> str:
        """What parameters without an estimate are: before there are data, none is unobservable."""
        waiting = self._view is not None and self._view.waiting
        return "○ waiting" if waiting else "✗ unobservable"

    def _small(self, snapshot: Snapshot, standing: Standing, width: int) -> list[Line]:
        sign = words.VERDICT[snapshot.result.verdict].sign
        head = f"{sign} {headline(snapshot)} {standing.reached}/{standing.total}"
        parts: Line = [(head, "bold")]
        room = width - len(head)
        groups = [("~ weak", standing.weak), (self._absent(), standing.missing)]
        groups = [(title, group) for title, group in groups if group]
        if not groups:
            groups = [("widest", standing.known[:1])]
        for number, (title, group) in enumerate(groups):
            share = room // (len(groups) - number)
            text = named(group, share - len(title) - 4, shares=group is not standing.missing)
            parts += [(f"   {title} ", "bold"), (text, "")]
            room -= len(title) + len(text) + 4
        return [parts]

    def _large(self, snapshot: Snapshot, standing: Standing, width: int) -> list[Line]:
        letters = big(f"{headline(snapshot)} {standing.reached}/{standing.total}")
        room = width - len(letters[0]) - 3
        within = f"{standing.reached} within the target of ±{100.0 * snapshot.target:g} %"
        known = f"{within}, widest {named(standing.known[:1], room)}" if standing.known else within
        room -= _TITLE + 4
        beside = (
            ("✓ identified", len(standing.known), known),
            ("~ weak", len(standing.weak), named(standing.weak, room)),
            (self._absent(), len(standing.missing), named(standing.missing, room, shares=False)),
        )
        assert len(beside) == HEIGHT
        return [
            [
                (line, ""),
                ("   ", ""),
                (f"{title:<{_TITLE}}", "bold"),
                (f"{count:>2}  ", "bold"),
                (text, ""),
            ]
            for line, (title, count, text) in zip(letters, beside, strict=True)
        ]
