"""Questions about a vehicle, one by one, each answer understood or refused in plain words."""

import math
import re
from argparse import ArgumentTypeError
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from gcs_sysid import argument_types
from gcs_sysid.errors import InputError
from gcs_sysid.files import check_target
from gcs_sysid.model.airframe import ANCHORS, MOST_ARM, Airframe, AnchorName, Rotor
from gcs_sysid.results.words import wrapped
from gcs_sysid.setup_help.airframe_file import (
    LAYOUTS,
    TWO_LENGTHS,
    Pen,
    airframe_text,
    arm_doubt,
    checked,
    draw,
    layout_rotors,
    legend,
    reversed_spins,
    rotor_table,
    scale_doubt,
)

_SPINS = {"ccw": 1, "cw": -1}


def _words(text: str) -> list[str]:
    """Apart at spaces, commas, semicolons and colons."""
    return [word for word in re.split(r"[\s,;:]+", text.strip()) if word]


T = TypeVar("T")


def understood(parse: Callable[[str], T], text: str) -> T:
    """What an option would take of a text.

    Raises:
        InputError: it cannot be understood.
    """
    try:
        return parse(text)
    except ArgumentTypeError as error:
        raise InputError(str(error)) from error


def _number(text: str) -> float:
    return understood(argument_types.number, text)


def plain_name(text: str) -> str:
    """A name of one line.

    Raises:
        InputError: it is empty, or has characters that cannot be printed.
    """
    if not text.strip() or not text.isprintable():
        raise InputError(f"the name must be one line of text, not {text!r}")
    return text.strip()


def arm_lengths(text: str, *, two: bool = True) -> float | tuple[float, float]:
    """One length in m or with its unit, or two where `two` allows it: forward and sideways.

    Raises:
        InputError: it is neither.
    """
    if re.fullmatch(r"\d+,\d+", text.strip()):
        raise InputError(f"decimals with a point: {text.strip().replace(',', '.')}")
    words = _words(text)
    if len(words) not in ((1, 2) if two else (1,)):
        raise InputError("one length in m" + (", or two: forward and sideways" if two else ""))
    lengths = [
        float(argument_types.parse_given("arm", word, "the arm"))
        if word[0].isdigit() and word[-1].isalpha()
        else understood(argument_types.positive, word)
        for word in words
    ]
    if max(lengths) > MOST_ARM:
        raise InputError(f"enter m; {max(lengths):g} m is too long")
    return lengths[0] if len(lengths) == 1 else (lengths[0], lengths[1])


def rotor(text: str) -> Rotor:
    """A rotor: x, y and spin in either order, such as "0.2 -0.2 cw" or "cw:0.2,-0.2".

    Raises:
        InputError: it is none.
    """
    words = _words(text)
    turns = [word.lower() for word in words if word.lower() in _SPINS]
    numbers = [_number(word) for word in words if word.lower() not in _SPINS]
    if len(turns) != 1 or len(numbers) != 2:
        raise InputError("enter x, y and ccw or cw, such as 0.2 -0.2 cw")
    if math.hypot(*numbers) > MOST_ARM:
        raise InputError(f"x and y are in m; {math.hypot(*numbers):g} m is too far out")
    return Rotor(numbers[0], numbers[1], _SPINS[turns[0]])


def spins(text: str, count: int) -> list[int]:
    """So many spins: +1 ccw, -1 cw.

    Raises:
        InputError: there are not so many, or they are something else.
    """
    words = [word.lower() for word in _words(text)]
    if len(words) != count or any(word not in _SPINS for word in words):
        raise InputError(f"usual, reversed, or {count} spins, each ccw or cw; not {text!r}")
    return [_SPINS[word] for word in words]


def imu_position(text: str) -> tuple[float, float, float]:
    """Three lengths in m: forward, right and down.

    Raises:
        InputError: they are not.
    """
    words = _words(text)
    if len(words) != 3:
        raise InputError("three lengths in m: forward, right and down, such as 0.02 0 -0.03")
    x, y, z = (_number(word) for word in words)
    if max(abs(x), abs(y), abs(z)) > MOST_ARM:
        raise InputError("enter the position of the IMU in m")
    return x, y, z


_OWN = "own"
_BACK = Rotor(math.nan, math.nan, 0)
"""Signals that the last motor is to be taken back."""
_SCALES: dict[str, AnchorName] = {"1": "mass", "2": "k_T", "3": "T_max"}


@dataclass
class GivenAnswers:
    """What options give already; None and empty: to be asked for."""

    layout: str | None = None
    arm: float | tuple[float, float] | None = None
    rotors: tuple[Rotor, ...] = ()
    spin: str | None = None
    scale: tuple[AnchorName, float] | None = None
    imu_position: tuple[float, float, float] | None = None
    priors: dict[str, tuple[float, float]] = field(default_factory=dict)
    name: str | None = None
    output: Path | None = None

    @property
    def complete(self) -> bool:
        """Whether nothing needs to be asked for."""
        placed = bool(self.rotors) or (self.layout is not None and self.arm is not None)
        return placed and self.output is not None


Answers = tuple[Airframe, str]
"""What a user enters about a vehicle, and where its rotors come from, in words."""


def given_answers(given: GivenAnswers) -> Answers:
    """The answers, of options alone.

    Raises:
        InputError: they do not go together, or are not complete.
    """
    usual, origin = _given_rotors(given)
    rotors = with_spins(usual, given.spin or "usual")
    stem = given.output.stem if given.output and str(given.output) != "-" else ""
    name = given.name or stem or given.layout or "airframe"
    airframe = Airframe(name, rotors, imu_position=given.imu_position, priors=given.priors)
    return _scaled(airframe, given.scale), _origin_of(origin, rotors == usual)


def _scaled(airframe: Airframe, scale: tuple[AnchorName, float] | None) -> Airframe:
    """With a scale of whatever size: whether it can be is said of the file."""
    anchors: dict[str, Any] = {} if scale is None else {scale[0]: scale[1]}
    return replace(airframe, **anchors)


def _given_rotors(given: GivenAnswers) -> tuple[tuple[Rotor, ...], str]:
    if given.rotors:
        if given.layout is not None or given.arm is not None:
            raise InputError("--rotor gives the positions; leave out --layout and --arm")
        return given.rotors, "Custom layout."
    if given.layout is None or given.arm is None:
        raise InputError("which layout? Give --layout and --arm, or --rotor for each motor")
    return _of_layout(given.layout, given.arm), _origin(given.layout)


def _of_layout(layout: str, arm: float | tuple[float, float]) -> tuple[Rotor, ...]:
    if isinstance(arm, tuple) and layout not in TWO_LENGTHS:
        raise InputError("two arm lengths, forward and sideways, are for a quad X only")
    return layout_rotors(layout, arm)


def _origin_of(origin: str, as_usual: bool) -> str:
    return origin if as_usual else f"{origin} Spins as given."


def _origin(layout: str) -> str:
    return f"{layout}: {LAYOUTS[layout]}."


def with_spins(rotors: tuple[Rotor, ...], text: str) -> tuple[Rotor, ...]:
    """The rotors with spins as given: "usual", "reversed", or one for each motor.

    Raises:
        InputError: the text says none of these.
    """
    word = text.strip().lower()
    if word == "usual":
        return rotors
    if word == "reversed":
        return reversed_spins(rotors)
    turns = spins(text, len(rotors))
    return tuple(Rotor(r.x, r.y, turn) for r, turn in zip(rotors, turns, strict=True))


def _can_fly(rotors: tuple[Rotor, ...]) -> tuple[Rotor, ...]:
    """The same rotors, if a file with them can be read.

    Raises:
        InputError: they cannot control a vehicle.
    """
    checked(airframe_text(Airframe("", rotors)), "these motors")
    return rotors


def _known_prior(text: str) -> tuple[str, float, float]:
    """A prior on a parameter that there is, with a value that it can have."""
    name, value, std = understood(argument_types.prior, text)
    Airframe("", ()).with_prior(name, value, std)
    return name, value, std


class Wizard:
    """Asks for what is not given.

    What `ask` raises ends all.
    """

    def __init__(self, ask: Callable[[str], str], say: Callable[[str], None], pen: Pen) -> None:
        self._ask = ask
        self._say = say
        self._pen = pen

    def answers(self, given: GivenAnswers) -> Answers:
        """Ask for what is missing, showing the rotors on the way."""
        if given.rotors or (given.layout is not None and given.arm is not None):
            rotors, origin = _given_rotors(given)
        else:
            rotors, origin = self._rotors(given)
        usual, rotors = rotors, self._spins(rotors, given.spin)
        origin = _origin_of(origin, rotors == usual)
        scale = given.scale or self._scale()
        imu = given.imu_position or self._imu()
        priors = given.priors or self._priors()
        name = given.name or self._name(given)
        return _scaled(Airframe(name, rotors, imu_position=imu, priors=priors), scale), origin

    def yes(self, question: str, *, default: bool) -> bool:
        """A question that has two answers."""
        choices = "Y/n" if default else "y/N"
        while True:
            word = self._ask(f"{question} [{choices}] ").strip().lower()
            if word == "":
                return default
            if word in ("y", "yes", "n", "no"):
                return word[0] == "y"
            self._say("  please answer y or n")

    def new_file(self, suggested: str) -> Path:
        """The name of a file that is not there yet."""
        while True:
            word = self._ask(f"File to write [{suggested}]: ").strip() or suggested
            path = Path(word if word.endswith(".toml") else f"{word}.toml")
            try:
                check_target(path, replace=False)
            except InputError as error:
                self._refuse(f"{error}; another name?")
            else:
                return path

    def _refuse(self, why: str) -> None:
        """Say what is wrong with an answer."""
        self._say("\n".join(wrapped(why, "  ")))

    def _until(self, question: str, parse: Callable[[str], T]) -> T:
        """Ask until the answer can be understood."""
        while True:
            answer = self._ask(f"{question}: ").strip()
            try:
                return parse(answer)
            except InputError as error:
                self._refuse(str(error))

    def _optional(self, question: str, parse: Callable[[str], T]) -> T | None:
        def or_nothing(text: str) -> T | None:
            return parse(text) if text else None

        return self._until(f"{question} (Enter: not known)", or_nothing)

    def _believed(
        self, question: str, parse: Callable[[str], T], doubt: Callable[[T], str | None]
    ) -> T:
        """Ask, and ask again whether a strange answer is meant."""
        while True:
            value = self._until(question, parse)
            why = doubt(value)
            if why is None:
                return value
            self._refuse(why)
            if self.yes("  Keep it?", default=False):
                return value

    def _rotors(self, given: GivenAnswers) -> tuple[tuple[Rotor, ...], str]:
        layout = given.layout or self._layout()
        if layout == _OWN:
            return self._own_rotors(), "Custom layout."
        two = layout in TWO_LENGTHS
        if given.arm is None:
            self._say("Distance from the center to each motor, in m? Such as 0.25.")
            if two:
                self._say(
                    "For a quad X that is not square: forward and sideways, such as 0.15 0.20."
                )
        arm = given.arm or self._believed(
            "Arm in m",
            lambda text: arm_lengths(text, two=two),
            lambda value: arm_doubt(max(value) if isinstance(value, tuple) else value),
        )
        return _of_layout(layout, arm), _origin(layout)

    def _layout(self) -> str:
        names = [*LAYOUTS, _OWN]
        words = {**LAYOUTS, _OWN: "custom, motor by motor"}
        self._say("Which layout?")
        for number, name in enumerate(names, 1):
            self._say(f"  {number:2d}  {name:<20}  {words[name]}")

        def choice(text: str) -> str:
            if text in names:
                return text
            if text.isdecimal() and 1 <= int(text) <= len(names):
                return names[int(text) - 1]
            raise InputError(f"a number from 1 to {len(names)}, or a name from the list")

        return self._until("Number or name", choice)

    def _own_rotors(self) -> tuple[Rotor, ...]:
        self._say(
            "Each motor in the autopilot's order: m forward, m to the right, spin from above,\n"
            "such as 0.2 -0.2 cw. Enter: done; back: removes the last one."
        )
        while True:
            rotors: list[Rotor] = []
            while (more := self._own_rotor(len(rotors) + 1)) is not None:
                if more is _BACK:
                    del rotors[-1:]
                else:
                    rotors.append(more)
            try:
                return _can_fly(tuple(rotors))
            except InputError as error:
                self._refuse(f"{error}. Again, from the first motor on.")

    def _own_rotor(self, number: int) -> Rotor | None:
        def one(text: str) -> Rotor | None:
            if text:
                return _BACK if text.lower() == "back" else rotor(text)
            if number <= 4:
                raise InputError("at least four motors")
            return None

        return self._believed(
            f"Motor {number}",
            one,
            lambda r: None if r is None or r is _BACK else arm_doubt(math.hypot(r.x, r.y)),
        )

    def _spins(self, rotors: tuple[Rotor, ...], given: str | None) -> tuple[Rotor, ...]:
        if given is not None:
            rotors = with_spins(rotors, given)
        self.show(rotors)
        if given is not None:
            return rotors

        def parsed(text: str) -> tuple[Rotor, ...]:
            word = "usual" if text.lower() in ("", "y", "yes") else text
            return _can_fly(with_spins(rotors, word))

        self._say(
            "Do the propellers spin this way? If not: reversed, if all spin the other way, or\n"
            "the spin of each motor, such as ccw ccw cw cw."
        )
        turned = self._until("Spins (Enter: as drawn)", parsed)
        if turned != rotors:
            self.show(turned)
        return turned

    def show(self, rotors: tuple[Rotor, ...]) -> None:
        """Draw the rotors."""
        picture = draw(rotors, self._pen)
        self._say(f"\n{picture}\n\n{legend(self._pen)}\n\n{rotor_table(rotors)}\n")

    def _scale(self) -> tuple[AnchorName, float] | None:
        self._say(
            "What sets the scale? One value must be known: motion alone fixes\n"
            "ratios only.\n"
            "   1  the mass, weighed ready to fly, in kg\n"
            "   2  k_T, thrust over the square of rotor speed, in N s^2 (with rpm telemetry)\n"
            "   3  T_max, thrust of one rotor at full command, in N (without)\n"
            "   4  later, on the command line"
        )

        def choice(text: str) -> str:
            if text in ("", "1", "2", "3", "4"):
                return text or "1"
            raise InputError("a number from 1 to 4")

        chosen = self._until("Number (Enter: 1)", choice)
        if chosen not in _SCALES:
            return None
        name = _SCALES[chosen]
        value = self._believed(
            f"{name} in {ANCHORS[name]}",
            partial(understood, argument_types.positive),
            lambda v: scale_doubt(name, v),
        )
        return name, value

    def _imu(self) -> tuple[float, float, float] | None:
        self._say("Where is the IMU? m forward, right and down from the center: 0.02 0 -0.03.")
        return self._optional("IMU", imu_position)

    def _priors(self) -> dict[str, tuple[float, float]]:
        found: dict[str, tuple[float, float]] = {}
        self._say("Is a parameter known from a bench test or CAD? Such as k_M=6.1e-6+-1e-7.")
        question = "NAME=VALUE+-STD"
        while (parsed := self._optional(question, _known_prior)) is not None:
            name, value, std = parsed
            found[name] = (value, std)
            question = "Another one"
        return found

    def _name(self, given: GivenAnswers) -> str:
        fallback = given.output.stem if given.output and given.output.stem != "-" else "my-vehicle"
        question = f"Name of the vehicle (Enter: {fallback})"
        return self._until(question, lambda text: plain_name(text or fallback))
