"""What exported files share: a header of origin and uncertainty, and numbers as XML has them."""

from collections.abc import Iterable
from dataclasses import dataclass

from gcs_sysid import __version__
from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import UNITS, KnownEstimate, Vehicle
from gcs_sysid.intervals import Z95
from gcs_sysid.model.parameters import REGISTRY

FOUR = 4
"""Rotors that several simulators fly, and no other number."""
ELEMENTS = {
    "ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2),
}  # fmt: skip
"""Names of the elements of an inertia matrix in SDF and URDF, in MuJoCo's order."""


@dataclass(frozen=True)
class Format:
    """A file format, and which parameters it takes.

    Attributes:
        name: on the command line.
        title: in words.
        suffix: of files.
        owner: what has no place for a parameter, such as "SIH has".
        needs: what it cannot do without.
        uses: what it has a place for beside these.
        lacks: what it has no place for, beside what changes the flight of any simulator.
    """

    name: str
    title: str
    suffix: str
    owner: str
    needs: tuple[str, ...]
    uses: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()

    def check(self, vehicle: Vehicle, rotors: int | None = None) -> None:
        """Check that all it needs is known, and that it flies so many rotors; None: any number.

        Raises:
            MissingError: it is not, or no body has this inertia.
            InputError: the vehicle has other than that many rotors.
        """
        if rotors is not None and len(vehicle.rotors) != rotors:
            count = len(vehicle.rotors)
            raise InputError(f"{self.name} flies {rotors} rotors, this vehicle has {count}")
        vehicle.need(self.name, self.needs)
        vehicle.check_inertia()

    def notes(self, vehicle: Vehicle) -> list[str]:
        """On what is only roughly known, and on what is known but has no place here."""
        taken = dict.fromkeys((*self.needs, *self.uses))
        weak = [n for n in taken if n in vehicle.known and vehicle.known[n].origin == "weak"]
        lost = [
            f"{name} ({vehicle[name]:.3g} {p.unit})"
            for name, p in REGISTRY.items()
            if (p.in_flight or name in self.lacks)
            and name not in taken
            and _is_there(vehicle, name)
        ]
        out = [f"weak: {', '.join(weak)}"] if weak else []
        return [*out, f"{self.owner} no place for {', '.join(lost)}"] if lost else out


def provenance(vehicle: Vehicle, target: Format, notes: Iterable[str]) -> list[str]:
    """The head of a file as lines without comment marks.

    Args:
        vehicle: exported.
        target: the format.
        notes: what a reader of the file should know.
    """
    result = vehicle.result
    scale = result.scale
    lines = [
        f"{vehicle.name}: {target.title}, written by gcs-sysid {__version__}",
        f"Flight: {_plain(result.source) or 'not named'}{_recorded(result.telemetry)}",
        f"Verdict: {result.verdict}"
        + ("" if not result.reasons else f" ({_plain('; '.join(result.reasons))})"),
        "Scale: "
        + ("none" if scale is None else f"{scale.anchor} = {scale.value:g} {_plain(scale.unit)}"),
        "Identified, 95 % intervals, SI; axes forward, right, down; inertia is matrix elements,",
        "CG from the geometric center:",
    ]
    lines += [_row(name, vehicle.known[name]) for name in UNITS if name in vehicle.known]
    unknown = [name for name in UNITS if name not in vehicle.known]
    if unknown:
        lines.append(f"Unknown: {', '.join(unknown)}")
    return [*lines, *(f"Note: {note}" for note in notes)]


def commented(lines: Iterable[str], mark: str) -> str:
    """Lines, each after a comment mark."""
    return "".join(f"{mark} {line}".rstrip() + "\n" for line in lines)


def xml_comment(lines: Iterable[str]) -> str:
    """Lines as one comment of XML, which must not hold two hyphens in a row."""
    text = "\n".join(f"  {line}" for line in lines)
    while "--" in text:
        text = text.replace("--", "- -")
    return f"<!--\n{text}\n-->\n"


def _is_there(vehicle: Vehicle, name: str) -> bool:
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
