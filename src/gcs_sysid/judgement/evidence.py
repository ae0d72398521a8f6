"""What objections may rest on: the estimates of a flight and all that is known around them."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from gcs_sysid.model.airframe import Airframe, ScaleKind
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY, Parameter
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.imu_checks import GyroAgainstAttitude, Saturated
from gcs_sysid.signals.records import Stream

if TYPE_CHECKING:
    from gcs_sysid.estimation.online.fit import Fit


@dataclass(frozen=True)
class Received:
    """What came of the data that an identification needs.

    Attributes:
        seen: streams of which anything came.
        recorded: s that the record lasts, where only a part of it was asked for.
        refused: rotor stream -> why it is not used.
        searched: whether the choice among rotor streams is made.
        has_rotors: whether there is a rotor stream in use.
        input_lost: why it was given up, or that no rotor ever turned by it; empty: neither.
        doubt: what else than the motors' it may be; empty: nothing else.
        outdated: whether the autopilot's parameters came too late to be heeded.
        flown: s in the air.
    """

    seen: frozenset[Stream] = frozenset()
    recorded: float | None = None
    refused: Mapping[str, str] = field(default_factory=dict)
    searched: bool = False
    has_rotors: bool = True
    input_lost: str = ""
    doubt: str = ""
    outdated: bool = False
    flown: float = 0.0


@dataclass(frozen=True)
class ClockDoubt:
    """Two clocks of which one is wrong.

    Attributes:
        share: by which the vehicle's is faster; negative: slower.
        by_gps: whether the other one is GPS time, which is right.
    """

    share: float
    by_gps: bool = False

    @property
    def how(self) -> str:
        """What to do."""
        if self.by_gps:
            return "multiply times by that share (--csv), or have the autopilot's clock repaired"
        return (
            "fly again with another computer to find the wrong one (a simulator is recognized by "
            "its SIM_ or SIH_ parameters)"
        )

    @property
    def reason(self) -> str:
        """In a pilot's words."""
        way = "fast" if self.share > 0.0 else "slow"
        runs = f"the vehicle's clock runs {100.0 * abs(self.share):.2f} % {way} against"
        costs = "inertia and k_M may be off by as much, and their intervals are wider by it"
        if self.by_gps:
            return f"{runs} GPS time: {costs}"
        link = "" if self.share > 0.0 else ", or the link lags increasingly"
        return (
            f"{runs} the receiving computer's, more than good clocks do, and either may be "
            f"wrong{link}: {costs}"
        )


@dataclass(frozen=True)
class Evidence:
    """All that producers of objections see; they read nothing else.

    Attributes:
        estimates: parameters by name. A producer sees them as its stage of `judge` finds them:
            without statuses, by the flight alone, or with what was given.
        fit: that they come from.
        airframe: that they rest on.
        rotor_input: of the rotors.
        anchor: kind of the given value that sets the scale.
        checked: whether fits are checked by their validation; the article's, which are for
            study, are not.
        interval: s between samples.
        filtered: whether the gyro comes through a low-pass, which colors its noise.
        given: name -> standard deviation that comes from what was given, SI.
        assumed: of the unit of the rotors' input, in words; empty where it is known.
        as_sent: that nothing checks it, in words; empty where something does.
        unlike: share by which rotors' speeds squared are not those of their commands; None where no
            commands show it.
        stale: that the rotor stream in use held old readings in a part of the flight; else empty.
        reread: whether rotor speeds declared as rpm were read as rad/s.
        turning: by what rotors turn faster than read, as what shakes the IMU shows; None: nothing.
        spins: share of the mean by which rotors of spin 1 lift more, and the others less, for the
            speed read, as yaw shows; None where they may lift alike.
        clock: what the vehicle's clock may be wrong by; None where nothing is to be doubted.
        gyro: what it reads of what the attitude turns; None where that is not known.
        saturated: sensors that stood at a limit.
        frozen: share of the IMU's samples that repeat the one before in all values.
        disordered: share of the IMU's samples that came after later ones, and are not used.
        contradicted: parameters as the flight alone has them, whose priors it contradicts.
        received: what came; None where only a fit is judged, not a flight.
        no_vehicle: why there is no vehicle; empty where there is one.
        confirmed: whether the vehicle reports the rotors that the airframe has.
        layout: what the vehicle says against the airframe.
        layout_notes: what it says otherwise where they agree in kind.
        problems: of link or log.
        parameters: the autopilot's.
        imu_loss: IMU samples that are missing, as in a result's telemetry.
        note: on the estimator, for those who asked for another.
        apart: name -> share of the value by which the offline estimate differs from the online one
            beyond chance, which its interval holds.
    """

    estimates: Mapping[str, Estimate]
    fit: "Fit"
    airframe: Airframe
    rotor_input: RotorInput = RotorInput.SPEED
    anchor: ScaleKind = "mass"
    checked: bool = True
    interval: float = 0.0
    filtered: bool = False
    given: Mapping[str, float] = field(default_factory=dict)
    assumed: str = ""
    as_sent: str = ""
    unlike: float | None = None
    stale: str = ""
    reread: bool = False
    turning: float | None = None
    spins: float | None = None
    clock: ClockDoubt | None = None
    gyro: GyroAgainstAttitude | None = None
    saturated: tuple[Saturated, ...] = ()
    frozen: float = 0.0
    disordered: float = 0.0
    contradicted: Mapping[str, Estimate] = field(default_factory=dict)
    received: Received | None = None
    no_vehicle: str = ""
    confirmed: bool = False
    layout: tuple[str, ...] = ()
    layout_notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    imu_loss: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""
    apart: Mapping[str, float] = field(default_factory=dict)

    def names(self, which: Callable[[Parameter], bool]) -> frozenset[str]:
        """Parameters of this kind that there are estimates of."""
        return frozenset(name for name in self.estimates if which(REGISTRY[name]))

    def share_of(self, names: Collection[str], share: float) -> dict[str, float]:
        """Name -> this share of its value, of those of these parameters that have one."""
        known = {n: e.value for n, e in self.estimates.items() if n in names}
        return {n: share * abs(value) for n, value in known.items() if value is not None}
