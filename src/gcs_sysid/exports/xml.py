"""Numbers as the XML formats write them."""

from collections.abc import Iterable

from gcs_sysid.arrays import Array

ELEMENTS = {
    "ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2),
}  # fmt: skip
"""Names of the elements of an inertia matrix in SDF and URDF, in MuJoCo's order."""


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
