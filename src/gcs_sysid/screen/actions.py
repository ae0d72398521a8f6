"""What keys and commands do to the session, each with a word of what happened."""

import os
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path

from textual.app import App
from textual.worker import Worker, WorkerState

from gcs_sysid.errors import GcsSysidError
from gcs_sysid.model.airframe import ANCHORS
from gcs_sysid.results.comparison import compare
from gcs_sysid.results.result_file import read_result
from gcs_sysid.results.snapshot import Snapshot
from gcs_sysid.screen.dialogs import Choose, Enter
from gcs_sysid.screen.view import Actions, EarlierResult


class ActingApp(App[None]):
    """The part of the application that acts; what is drawn is `SysidApp`'s.

    Args:
        actions: what can be done with the source.
        baseline: an earlier result to compare with.
    """

    def __init__(self, actions: Actions, baseline: EarlierResult | None) -> None:
        super().__init__()
        self.actions = actions
        self.baseline = baseline
        self._marks = 0
        self._at_work: set[str] = set()

    @property
    @abstractmethod
    def snapshot(self) -> Snapshot | None:
        """What is shown."""

    @abstractmethod
    def say(self, text: str) -> None:
        """Answer an action with a sentence above the footer."""

    @abstractmethod
    def draw(self) -> None:
        """Draw the present view."""

    def _ask(self, action: Callable[[], str]) -> None:
        """Do something with the source, and say what came of it, even if it failed."""
        try:
            self.say(action())
        except (GcsSysidError, OSError) as error:
            self.say(f"Not done: {error}")

    def _lacks(self, what: str, action: object) -> bool:
        """Whether the source cannot do this; then it is said."""
        if action is None:
            self.say(f"{what}: not {self.actions.absent}.")
        return action is None

    def _in_thread(self, what: str, action: Callable[[], str]) -> None:
        """Do something that takes its time, beside the flow of data."""
        if what in self._at_work:
            self.say(f"{what}: the last one is not finished.")
            return
        self._at_work.add(what)
        self.say(f"{what}: working ...")

        def work() -> None:
            try:
                answer = action()
            except (GcsSysidError, OSError) as error:
                answer = f"Not done: {error}"
            if self.is_running:  # else the user has left meanwhile
                self.call_from_thread(self.say, answer)

        # A defect in there is reported too, and must not end a session in flight.
        self.run_worker(work, name=what, thread=True, exit_on_error=False)

    def on_worker_state_changed(self, event: Worker.StateChanged) -> None:
        """Something beside the flow of data has come to its end."""
        if event.worker.is_finished:
            self._at_work.discard(event.worker.name)
        if event.state is WorkerState.ERROR:
            error = event.worker.error
            self.say(f"{event.worker.name}: internal error ({type(error).__name__}: {error})")

    # -- marks, the estimate, the recording

    def action_mark(self) -> None:
        """Mark the present instant with a number; a pilot has no hand free to type."""
        act = self.actions.mark

        def mark() -> str:
            assert act is not None
            act(f"mark {self._marks + 1}")
            self._marks += 1
            return f"Marked: mark {self._marks}"

        if not self._lacks("Mark", act):
            self._ask(mark)

    def action_reset(self) -> None:
        """Restart the estimate, once the user has confirmed: the data so far are discarded."""
        act = self.actions.reset

        def reset() -> str:
            assert act is not None
            act()
            return "Reset: the estimate restarts."

        def confirmed(answer: str | None) -> None:
            if answer == "reset":
                self._ask(reset)
            else:
                self.say("Reset: cancelled.")

        if not self._lacks("Reset", act):
            choices = [("keep", "keep the estimate"), ("reset", "discard the data so far")]
            self.push_screen(Choose("Reset the estimate?", choices), confirmed)

    def action_record(self) -> None:
        """Start or stop recording."""
        act = self.actions.toggle_recording
        if not self._lacks("Record", act):
            assert act is not None
            self._ask(act)

    # -- files

    def action_export(self) -> None:
        """Write the present result for a simulator."""
        act = self.actions.export
        if self._lacks("Export", act):
            return
        assert act is not None
        if self.snapshot is None:
            self.say("Nothing to export yet.")
            return
        result = self.snapshot.result

        def write(target: str | None) -> None:
            if target is None:
                self.say("Export: nothing written.")
                return
            self._in_thread("Export", lambda: act(target, result))

        targets = [(name, name) for name in self.actions.export_targets]
        hint = "Writes the present values to a new file."
        self.push_screen(Choose("Export for a simulator", targets, hint), write)

    def action_report(self) -> None:
        """Write a report of the flight so far."""
        act = self.actions.report
        if not self._lacks("Report", act):
            assert act is not None
            self._in_thread("Report", act)

    # -- scale and vehicle

    def action_scale(self) -> None:
        """Set the scale: first which quantity, then its value."""
        if self._lacks("Scale", self.actions.set_anchor):
            return
        if self.snapshot is None:
            self.say("No result yet.")
            return
        result = self.snapshot.result
        thrust = result.rotor_input.thrust
        words = {
            "mass": "mass, weighed, kg",
            "k_T": "k_T, thrust over speed squared, N s²",
            "T_max": "T_max, thrust of a rotor at full command, N",
        }
        now = "nothing" if result.scale is None else f"{result.scale.anchor} {result.scale.value:g}"

        def ask_value(kind: str | None) -> None:
            if kind is None:
                self.say("Scale unchanged.")
                return
            known = result.parameters.get(kind)
            value = "" if known is None or known.value is None else f"{known.value:.6g}"
            hint = f"{words[kind]}. Scales all masses, inertias and coefficients."
            self.push_screen(Enter("Scale", hint, value), lambda text: self._set_anchor(kind, text))

        kinds = [(kind, words[kind]) for kind in ("mass", thrust)]
        self.push_screen(Choose("What sets the scale?", kinds, f"Now: {now}"), ask_value)

    def _set_anchor(self, kind: str, text: str | None) -> None:
        act = self.actions.set_anchor
        assert act is not None
        if text is None:
            self.say("Scale unchanged.")
            return
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            self.say(f"Not done: {text!r} is not a number ({ANCHORS[kind]} wanted)")  # type: ignore[index]
            return
        self._ask(lambda: act(kind, value))

    def action_vehicle(self) -> None:
        """Choose among the vehicles on the link."""
        act = self.actions.choose_vehicle
        if self._lacks("Vehicle", act):
            return
        assert act is not None
        received = () if self.snapshot is None else self.snapshot.link.vehicles
        if len(received) < 2:
            self.say("Only one vehicle on the link." if received else "No vehicle yet.")
            return
        by_name = {vehicle.name: vehicle for vehicle in received}

        def choose(name: str | None) -> None:
            if name is None or by_name[name].chosen:
                self.say("Vehicle unchanged.")
                return
            self._ask(lambda: act(by_name[name].address))

        listed = [(v.name, f"{'●' if v.chosen else '○'} {v.name}") for v in received]
        hint = "Another vehicle restarts the session in a new recording."
        self.push_screen(Choose("Which vehicle?", listed, hint), choose)

    # -- an earlier result

    def action_baseline(self) -> None:
        """Ask for an earlier result to compare with."""
        near = sorted(str(path) for path in Path().glob("*.json"))
        hint = "A result written by --json; empty: no baseline."
        value = "" if self.baseline is None else self.baseline.name
        self.push_screen(Enter("Compare with", hint, value, near), self._load_baseline)

    def _load_baseline(self, name: str | None) -> None:
        if name is None:
            self.say("Baseline unchanged.")
            return
        if not name:
            self.baseline = None
            self.say("Baseline removed.")
            self.draw()
            return

        def load() -> str:
            found = read_result(Path(os.path.expanduser(name)))
            if self.snapshot is not None:
                compare(found, self.snapshot.result)  # another vehicle is refused
            self.baseline = EarlierResult(name, found)
            return f"Compared with {name}: {found.verdict}, from {found.source or 'one flight'}"

        self._ask(load)
        self.draw()
