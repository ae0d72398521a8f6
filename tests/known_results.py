"""Results of values that a test names, by rotor speeds and a mass unless it says otherwise."""

from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import Scale

MASS = {"mass": Estimate(1.5, 0.0, "kg", "given")}
USUAL = {
    "verdict": "identified", "reasons": (), "source": "a.tlog",
    "vehicle": {"sysid": 1, "compid": 1, "autopilot": "px4"},
    "scale": Scale("mass", 1.5, "kg"), "rotor_input": RotorInput.SPEED,
}  # fmt: skip


def estimates(values, share=0.0, std=0.0, statuses=None):
    """Name -> estimate.

    Args:
        values: name -> value; None: unobservable.
        share: of each value that its standard deviation is.
        std: what is added to that.
        statuses: name -> status of those that are not identified.
    """
    statuses = statuses or {}
    return {
        name: Estimate(None, None, REGISTRY[name].unit, "unobservable")
        if value is None
        else Estimate(
            value, std + share * abs(value), REGISTRY[name].unit, statuses.get(name, "identified")
        )
        for name, value in values.items()
    }


def result_of(parameters, **fields):
    """A result with these estimates; fields besides are those of `Result`."""
    return Result(**(USUAL | fields), parameters=parameters)
