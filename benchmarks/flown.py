"""Accuracy of the inertia from a minute of flying, by what is flown: the table of docs/flying.md.

    python -m benchmarks.flown

By the coach's model (`gcs_sysid.coach.information`), for the article's vehicle and, in the last
column, for PX4's simulated one; their mass is given, their sensors are usual ones at 250 Hz, and
nothing is flown. One standard deviation.
"""

import math
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.coach.information import Craft, information, motion_of, prior_noise, prior_vehicle
from gcs_sysid.coach.manoeuvre_library import Manoeuvre
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import load_airframe
from sim_bridge.vehicle_files import load_vehicle
from testbed.study import arguments, markdown

SECONDS = 60.0
Swing = tuple[float, float, float]
"""Degrees of roll, pitch and yaw, to each side, at once."""


def apart(degrees: float) -> list[Swing]:
    """One axis after the other."""
    return [(degrees, 0.0, 0.0), (0.0, degrees, 0.0), (0.0, 0.0, degrees)]


def together(degrees: float) -> list[Swing]:
    """Roll with yaw, then pitch with yaw."""
    return [(degrees, 0.0, degrees), (0.0, degrees, degrees)]


FLOWN: dict[str, list[Swing]] = {
    "yaw alone, ±20°": [(0.0, 0.0, 20.0)],
    "roll, pitch, yaw one after the other, ±20°": apart(20.0),
    "roll with yaw, pitch with yaw, ±5°": together(5.0),
    "the same, ±10°": together(10.0),
    "the same, ±20°": together(20.0),
}


def craft_of(name: str) -> tuple[Craft, Array]:
    """An emulated vehicle as it is, and (N_UNKNOWNS,) margins of what one could have assumed."""
    vehicle, expected = load_vehicle(name), prior_vehicle(load_airframe(name))
    true = vehicle.truth()
    theta = rb.theta_of(true, true["k_T"])
    expected = expected.at(true["k_T"] / true["mass"])
    return replace(expected.craft, theta=theta), expected.std


def deviations(swings: list[Swing], craft: Craft, margin: Array) -> Array:
    """(N_INERTIA + 1,) standard deviations after a minute, an even share of each swing.

    Of the moments of inertia and the moment ratio over themselves, of the products over Ixx.
    """
    total = np.diag(1.0 / margin**2)
    for degrees in swings:
        roll, pitch, yaw = map(math.radians, degrees)
        flown = Manoeuvre("", roll=roll, pitch=pitch, yaw=yaw)
        told = information(motion_of(flown, craft), craft, prior_noise(craft))
        total += SECONDS / len(swings) * told
    size = np.sqrt(np.diag(total))
    covariance = np.linalg.inv(total / np.outer(size, size)) / np.outer(size, size)
    shown = [*range(rb.N_INERTIA), rb.MOMENT_RATIO]
    moments = craft.theta[[0, 1, 2]]
    reference = np.concatenate([moments, moments[[0, 0, 0]], craft.theta[[rb.MOMENT_RATIO]]])
    share: Array = np.sqrt(np.diag(covariance))[shown] / reference
    return share


def percent(share: float) -> str:
    """Beyond half of itself, nothing is known of a number."""
    return f"{share:.2g} %" if share < 50.0 else "nothing"


def main() -> None:
    arguments(__doc__).parse_args()
    head = "flown for a minute | Ixx, Iyy | products, of Ixx | Izz and k_M | of a balanced vehicle"
    print(*markdown(head), sep="\n")
    article, balanced = craft_of("paper"), craft_of("px4-sih")
    for words, swings in FLOWN.items():
        Ixx, Iyy, Izz, Ixy, Iyz, Ixz, ratio = 100.0 * deviations(swings, *article)
        _, _, other, *_, other_ratio = 100.0 * deviations(swings, *balanced)
        shares = max(Ixx, Iyy), max(Ixy, Iyz, Ixz), max(Izz, ratio), max(other, other_ratio)
        print(f"| {words} | {' | '.join(map(percent, shares))} |")


if __name__ == "__main__":
    main()
