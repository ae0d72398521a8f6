"""The flight coach beside a running chain: advice for the snapshots.

It only reads: what the chain estimates is the same with a coach and without.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.coach.choice import Choice, choose, is_enough, shares
from gcs_sysid.coach.information import (
    Noise,
    PredictedInformation,
    predicted_information,
    prior_noise,
    prior_vehicle,
    speed_noise,
)
from gcs_sysid.coach.manoeuvre_library import (
    Limits,
    Manoeuvre,
    axis_words,
    damped_words,
    library,
    motion_words,
    sentence,
)
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.model.parameters import AXES
from gcs_sysid.results.snapshot import Advice, Gain
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.sampling import SampleBlock


@dataclass(frozen=True)
class CoachRules:
    """When the coach looks, waits, and takes a maneuver for flown.

    Attributes:
        every: s of vehicle time between looks.
        stale: s after which advice that is not followed is reconsidered.
        again: the same where no maneuver was found.
        begun: progress from which advice is being followed.
        flown: progress at which it has been flown: swings never have exactly the size asked.
        least_seconds: s of flight from which its residuals give the noise, and hover the CG.
        groping: share of an interval of Ixx or Iyy from which a fit is not gone on from.
        first: s, of the first maneuver of a vehicle of which nothing is known.
        matters: share of a maneuver's motion from which an axis belongs to it.
        window: s of flight in which motion is compared with what was asked: a period and more.
        swinging: share of the asked squared rates from which the maneuver counts as begun: a
            seventh of the swing.
        tried_for: s of that after which what comes is what the autopilot lets through.
        reacts_within: s in which a pilot reads the advice and goes over to it.
        damped: share of the asked swing below which another pace may give more information.
    """

    every: float = 1.0
    stale: float = 10.0
    again: float = 5.0
    begun: float = 0.1
    flown: float = 0.9
    least_seconds: float = 3.0
    groping: float = 0.5
    first: float = 6.0
    matters: float = 0.1
    window: float = 1.0
    swinging: float = 0.02
    tried_for: float = 4.0
    reacts_within: float = 2.0
    damped: float = 0.6


RULES = CoachRules()


@dataclass(frozen=True)
class CoachOptions:
    """What a pilot may set.

    Attributes:
        target: half of a 95 % interval over the value, which every parameter is to reach.
        limits: of the maneuvers.
    """

    target: float = 0.02
    limits: Limits = field(default_factory=Limits)


class Coach:
    """Watches a chain and says what to fly next.

    To weigh all maneuvers takes a tenth of a second: `look` now and then, `think` when there is
    nothing else to do. `advise` does both. The chain is fed elsewhere; the coach observes its
    samples.
    """

    def __init__(self, chain: Chain, options: CoachOptions | None = None) -> None:
        self.options = options or CoachOptions()
        self.choice: Choice | None = None
        """What is advised."""
        self._chain = chain
        self._library = library(self.options.limits)
        self._advice: Advice | None = None
        self._thought: tuple[Fit, dict[str, float | None]] | None = None
        self._text = ""
        self._gains: tuple[str, ...] = ()
        self._next_look = 0.0
        self._chosen_at = -np.inf
        self._seconds = 0.0
        self._gathered = np.zeros(4)
        # (axis, Hz) -> share of the asked swing that came.
        self._swings: dict[tuple[str, float], float] = {}
        self._window = np.zeros(4)  # squared rates and s of the window that fills
        self._tried = np.zeros(4)  # the same over windows with motion
        self._asked = np.zeros(3)  # squared rates, mean over what is advised
        self._damped = ""
        chain.observers.append(self.add_samples)

    def add_samples(self, block: SampleBlock) -> None:
        """Gather what motion there is in a block."""
        samples = block.samples.part(block.flying)
        rates = samples.rates[np.isfinite(samples.rates).all(axis=1)]
        down = samples.velocity[:, 2]
        down = down[np.isfinite(down)]
        squares = (rates * rates).sum(axis=0) * block.dt
        self._gathered[:3] += squares
        self._compare(squares, len(rates) * block.dt)
        if down.size:
            # Velocity comes more slowly than the samples it is placed on.
            self._gathered[3] += float(np.mean(down * down)) * len(samples.gyro) * block.dt

    def _compare(self, squares: Array, seconds: float) -> None:
        """Keep the motion while the advised maneuver is flown."""
        if self._chain.t - self._chosen_at < RULES.reacts_within:
            return  # what was advised before
        self._window += (*squares, seconds)
        if self._window[3] < RULES.window:
            return
        if self._window[:3].sum() >= RULES.swinging * self._asked.sum() * self._window[3] > 0.0:
            self._tried += self._window
        self._window[:] = 0.0

    def advise(self) -> Advice | None:
        """What to fly next; about once a second it is thought over."""
        self.look()
        self.think()
        return self.look()

    def look(self) -> Advice | None:
        """The same as far as it is thought over."""
        chain = self._chain
        if not chain.sampler.flying:
            self._forget()
            self._next_look = 0.0
        elif chain.t >= self._next_look:
            self._next_look = chain.t + RULES.every
            self._see()
        return self._advice

    def think(self) -> None:
        """Weigh all maneuvers, if that is due."""
        thought, self._thought = self._thought, None
        # A reset may have come in between: there is no estimate to advise on.
        if thought is not None and self._chain.estimator is not None:
            self._weigh(*thought)

    def _forget(self) -> None:
        self.choice = self._advice = self._thought = None
        self._chosen_at = -np.inf

    def _see(self) -> None:
        """Look how things stand, and begin to think where that is worth it."""
        fit = self._chain.fit
        if fit.seconds < RULES.least_seconds:
            self._forget()
            return
        now = self._judge(fit)
        if is_enough(now, self.options.target):
            self._forget()
            self._advice = Advice("", f"enough: {self._met(now)}", progress=1.0, enough=True)
            return
        if self._thought is not None:
            return
        if self._is_damped():
            self._begin(fit, now)
            return
        progress = self._progress()
        since = self._chain.t - self._chosen_at
        if (
            (self.choice is None and since >= RULES.again)
            or fit.seconds < self._seconds  # something has changed, or was reset
            or progress >= RULES.flown
            or (progress < RULES.begun and since >= RULES.stale)
        ):
            self._begin(fit, now)
        else:
            self._advice = self._advice_now(now, progress)
        self._seconds = fit.seconds

    def _is_damped(self) -> bool:
        """Whether the advised maneuver comes out much smaller than asked, which is then kept."""
        if self.choice is None or self._tried[3] < RULES.tried_for:
            return False
        asked = self.choice.manoeuvre
        share = np.sqrt(self._tried[:3] / self._tried[3] / np.maximum(self._asked, 1e-12))
        self._tried[:] = 0.0
        found = False
        for axis, came, squares in zip(AXES, share, self._asked, strict=True):
            if squares <= RULES.matters * self._asked.max():
                continue
            key = axis, asked.yaw_pace if axis == "yaw" else asked.pace
            before = self._swings.get(key, 1.0)
            if came < RULES.damped or came > before:
                self._swings[key] = float(min(came, 1.0))
            if came < RULES.damped * before:
                found = True
                self._damped = damped_words(asked, float(came))
        return found

    def _achieved(self, manoeuvre: Manoeuvre) -> Manoeuvre:
        """A maneuver as the vehicle flies it: damped at one pace, damped at a brisker one too."""
        shares = {}
        for axis in AXES:
            pace = manoeuvre.yaw_pace if axis == "yaw" else manoeuvre.pace
            seen = [s for (name, hz), s in self._swings.items() if name == axis and hz <= pace]
            shares[axis] = min(seen, default=1.0) * getattr(manoeuvre, axis)
        return replace(manoeuvre, **shares)

    def _begin(self, fit: Fit, now: dict[str, float | None]) -> None:
        """Begin to think about what to fly next."""
        if any((now[name] or 1.0) >= RULES.groping for name in ("Ixx", "Iyy")):
            # What a hover's noise looks like is no vehicle.
            fit = replace(fit, rotation=None)
        self._thought = fit, now

    def _weigh(self, fit: Fit, now: dict[str, float | None]) -> None:
        found = None
        # Estimates may be anything while a flight begins; no advice is worth a session.
        with suppress(np.linalg.LinAlgError):
            prospect = self._prospect(fit)
            target = self.options.target
            found = choose(prospect, self._library, self._judge, target, self._achieved)
        self._settle(found, fit, now)

    def _settle(self, found: Choice | None, fit: Fit, now: dict[str, float | None]) -> None:
        """Advise what was found."""
        self._chosen_at = self._chain.t
        self._gathered[:] = 0.0
        self._window[:] = self._tried[:] = 0.0
        self._gains = ()
        self.choice = found
        self._asked[:] = 0.0 if found is None else self._asked_squares(found)
        if found is not None and fit.rotation is None:
            # A rule of thumb picks the maneuver, but promises nothing.
            self.choice = replace(found, manoeuvre=found.manoeuvre.lasting(RULES.first))
            self._text = f"{motion_words(self.choice.manoeuvre)}: first estimates of all parameters"
        elif found is not None:
            # Gains are reported against the intervals that the pilot sees.
            self.choice = found = replace(found, now=now)
            names = found.names_above(self.options.target)
            self._gains = tuple(names[:4])
            self._text = sentence(found.manoeuvre, names, now, found.expected)
        if self._damped and self.choice is not None:
            self._text, self._damped = f"{self._damped}; {self._text}", ""
        self._advice = self._advice_now(now, 0.0)

    def _asked_squares(self, choice: Choice) -> Array:
        """(3,) squared body rates, mean over the maneuver as it is asked."""
        came = self._achieved(choice.manoeuvre)
        squares = (choice.motion.rates**2).mean(axis=0)
        for k, axis in enumerate(AXES):
            swing = getattr(came, axis)
            squares[k] *= (getattr(choice.manoeuvre, axis) / swing) ** 2 if swing else 1.0
        return squares

    def _advice_now(self, now: Mapping[str, float | None], progress: float) -> Advice | None:
        choice = self.choice
        if choice is None:
            return None
        gains = tuple(
            Gain(name, now.get(name), share)
            for name in self._gains
            for share in (choice.expected[name],)
            if share is not None
        )
        manoeuvre = choice.manoeuvre
        return Advice(
            manoeuvre.name,
            self._text,
            manoeuvre.seconds,
            progress,
            gains,
            axes=axis_words(manoeuvre),
        )

    def _judge(self, fit: Fit) -> dict[str, float | None]:
        chain = self._chain
        return shares(chain.values(fit), chain.airframe.arm, chain.rotor_input)

    def _prospect(self, fit: Fit) -> PredictedInformation:
        chain = self._chain
        known = prior_vehicle(chain.airframe, chain.rotor_input)
        estimator = chain.estimator
        assert estimator is not None
        usual = prior_noise(known.craft)
        prospect = predicted_information(fit, known, usual, estimator.record.basis.free)
        gyro, torque = usual.gyro, usual.torque
        if not chain.rotor_input.motors:
            torque = speed_noise(prospect.craft, estimator.record.input_noise.std, estimator.dt)
        if fit.rotation is not None:
            gyro = estimator.rotation.gyro_density(fit.rotation, prospect.craft.theta)
        return replace(prospect, noise=Noise(gyro, torque))

    def _progress(self) -> float:
        """Share of the advised motion that was flown, on the axis that has least of its own."""
        if self.choice is None:
            return 0.0
        wanted = _motion(self.choice)
        counts = wanted > RULES.matters * wanted[:3].max() if wanted[:3].any() else wanted > 0.0
        return float(min((self._gathered[counts] / wanted[counts]).min(), 1.0))

    def _met(self, now: Mapping[str, float | None]) -> str:
        widest = max((s, n) for n, s in now.items() if s is not None)
        return (
            f"every interval is within {100.0 * self.options.target:g} % "
            f"(widest: {widest[1]}, {100.0 * widest[0]:.1f} %)"
        )


def _motion(choice: Choice) -> Array:
    """(4,) integrals of squared body rates, and of climb rate, over the maneuver."""
    manoeuvre = choice.manoeuvre
    climb = 0.5 * (2.0 * np.pi * manoeuvre.pace * manoeuvre.climb) ** 2
    squares = np.append((choice.motion.rates**2).mean(axis=0), climb)
    return squares * manoeuvre.effective_seconds
