"""A file format of exports: its places for parameters, its head, and numbers as XML has them."""

from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from gcs_sysid import __version__
from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import UNITS, ExportedVehicle, KnownEstimate
from gcs_sysid.model.parameters import INERTIA, REGISTRY
from gcs_sysid.significance import Z95

ELEMENTS = {
    "ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2),
}  # fmt: skip
"""Names of the elements of an inertia matrix in SDF and URDF, in MuJoCo's order."""


_EITHER = (("k_T", "T_max"), ("k_M", "moment_ratio"))
"""Parameters that say the same of a vehicle that flies: one of two is enough."""


@dataclass(frozen=True)
class Format:
    """A file format: what it has a place for, and how it is written.

    Attributes:
        name: on the command line.
        title: in words.
        suffix: of files.
        owner: what has no place for other parameters, such as "SIH has".
        needs: parameters that it cannot do without; a possible inertia it needs in any case.
        text: the file, from the vehicle and the lines of its head, to be made a comment.
        uses: parameters that it has a place for beside these.
        absent: parameter -> what to say where it is not known, or known to be zero.
        remarks: what else the user should know of this vehicle in this format.
        rotors: that it flies; None: any number.
        begins: deg north and east, m above the sea, where a simulator begins that flies missions.
    """

    name: str
    title: str
    suffix: str
    owner: str
    needs: tuple[str, ...]
    text: Callable[[ExportedVehicle, list[str]], str]
    uses: tuple[str, ...] = ()
    absent: Mapping[str, str] = field(default_factory=dict)
    remarks: Callable[[ExportedVehicle], list[str]] = lambda _: []
    rotors: int | None = None
    begins: tuple[float, float, float] | None = None

    def write(self, vehicle: ExportedVehicle) -> str:
        """The file.

        Raises:
            MissingError: a parameter that it cannot do without is not known, or no body has this
                inertia.
            InputError: it flies another number or layout of rotors.
        """
        count = len(vehicle.rotors)
        if self.rotors is not None and count != self.rotors:
            raise InputError(f"{self.name} flies {self.rotors} rotors, this vehicle has {count}")
        vehicle.need(self.name, dict.fromkeys((*self.needs, *INERTIA)))
        vehicle.check_inertia()
        return self.text(vehicle, self._head(vehicle))

    def notes(self, vehicle: ExportedVehicle) -> list[str]:
        """What is only roughly known, has no place here or is absent, and remarks."""
        taken = dict.fromkeys((*self.needs, *self.uses))
        weak = [n for n in taken if n in vehicle.known and vehicle.known[n].origin == "weak"]
        lost = [
            f"{name} ({vehicle[name]:.3g} {REGISTRY[name].unit})"
            for name in _moving(taken)
            if name not in taken and _is_there(vehicle, name)
        ]
        notes = [f"weak: {', '.join(weak)}"] if weak else []
        notes += [f"{self.owner} no place for {', '.join(lost)}"] if lost else []
        notes += [text for name, text in self.absent.items() if _is_absent(vehicle, name)]
        return notes + self.remarks(vehicle)

    def _head(self, vehicle: ExportedVehicle) -> list[str]:
        """Origin, values with their intervals and notes, as lines without comment marks."""
        result = vehicle.result
        scale = "none"
        if result.scale is not None:
            unit = _plain(result.scale.unit)
            scale = f"{result.scale.anchor} = {result.scale.value:g} {unit}"
        reasons = f" ({_plain('; '.join(result.reasons))})" if result.reasons else ""
        unknown = [name for name in UNITS if name not in vehicle.known]
        return [
            f"{vehicle.name}: {self.title}, written by gcs-sysid {__version__}",
            f"Flight: {_plain(result.source) or 'not named'}{_recorded(result.telemetry)}",
            f"Verdict: {result.verdict}{reasons}",
            f"Scale: {scale}",
            "Identified, 95 % intervals, SI; axes forward, right, down; inertia is matrix "
            "elements,",
            "CG from the geometric center:",
            *(_row(name, vehicle.known[name]) for name in UNITS if name in vehicle.known),
            *([f"Unknown: {', '.join(unknown)}"] if unknown else ()),
            *(f"Note: {note}" for note in self.notes(vehicle)),
        ]


def _moving(taken: Container[str]) -> Iterator[str]:
    """Parameters without which a simulated vehicle flies in another way."""
    for name, parameter in REGISTRY.items():
        pair = next((pair for pair in _EITHER if name in pair), ())
        either = bool(pair) and not any(one in taken for one in pair)
        if parameter.in_flight or name in INERTIA or either:
            yield name


def _is_absent(vehicle: ExportedVehicle, name: str) -> bool:
    value = vehicle.get(name)
    return value is None or (value == 0.0 and REGISTRY[name].sign != "any")


def commented(lines: Iterable[str], mark: str) -> str:
    """Lines, each after a comment mark."""
    return "".join(f"{mark} {line}".rstrip() + "\n" for line in lines)


def xml_comment(lines: Iterable[str]) -> str:
    """Lines as one comment of XML, which must not hold two hyphens in a row."""
    text = "\n".join(f"  {line}" for line in lines)
    while "--" in text:
        text = text.replace("--", "- -")
    return f"<!--\n{text}\n-->\n"


def _is_there(vehicle: ExportedVehicle, name: str) -> bool:
    """Whether a parameter is known, and known not to be zero."""
    value = vehicle.get(name)
    return bool(value) and abs(value or 0.0) > Z95 * (vehicle.known[name].std or 0.0)


def _row(name: str, known: KnownEstimate) -> str:
    unit = "" if UNITS[name] == "1" else f" {UNITS[name]}"
    half = f" +- {Z95 * known.std:.2g}" if known.std else ""
    return f"  {name} = {known.value:.6g}{half}{unit} ({_plain(known.origin)})"


def _recorded(telemetry: object) -> str:
    when = telemetry.get("recorded") if isinstance(telemetry, dict) else None
    return f", recorded {_plain(when)}" if isinstance(when, str) else ""


def _plain(text: str) -> str:
    """Text that stays on one line."""
    return "".join(c if c.isprintable() else " " for c in text)


def number(value: float) -> str:
    """A number without needless digits; never -0."""
    return f"{float(value) + 0.0:.10g}"


def numbers(values: Iterable[float]) -> str:
    """Numbers with a space between."""
    return " ".join(map(number, values))


def inertia_attributes(inertia: Array) -> str:
    """A (3, 3) inertia matrix as URDF's attributes."""
    return " ".join(f'{name}="{number(inertia[at])}"' for name, at in ELEMENTS.items())


def inertia_elements(inertia: Array) -> str:
    """A (3, 3) inertia matrix as SDF's elements."""
    return "".join(f"<{name}>{number(inertia[at])}</{name}>" for name, at in ELEMENTS.items())
