"""Analysis of recorded flights."""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe, ScaleReference
from gcs_sysid.results.result import Result
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.origin import Origin
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector
from gcs_sysid.signals.sampling import WINDOW, SampleBlock, Sampler
from gcs_sysid.telemetry.logs import Log, open_log


class Observer(Protocol):
    """Looks on while a log is analyzed."""

    def begin(self) -> None:
        """A reading of the log begins; one before it does not count."""

    def take(self, block: SampleBlock) -> None:
        """The next block of samples."""

    def end(self, chain: Chain) -> None:
        """All is read, and the estimate final."""


class RecordKeeper(Protocol):
    """Keeps records of a log while it is analyzed, so that it is read once."""

    def begin(self, log: Log) -> None:
        """A reading of the log begins; one before it does not count."""

    def add_records(self, block: RecordBlock) -> None:
        """The next block of records."""

    def end(self, sampler: Sampler) -> None:
        """All is read, and what took it is the sampler."""


def analyze_log(
    path: Path,
    airframe: Airframe,
    wanted: tuple[int, int | None] | None = None,
    options: ChainOptions | None = None,
    progress: Callable[[float], None] | None = None,
    anchor: ScaleReference | None = None,
    observers: Sequence[Observer] = (),
    keeper: RecordKeeper | None = None,
    opened: Log | None = None,
) -> Result:
    """Identify from a recording.

    Args:
        path: of a log.
        airframe: without a scale, the vehicle's mass is the unit: see `Airframe.in_own_units`.
        wanted: system and perhaps component; None: the first autopilot in the log.
        options: of the chain; by default the estimate's history is not computed.
        progress: called with the share of the log done, 0 to 1, now and then.
        anchor: sets the scale instead of the airframe's.
        observers: look on.
        keeper: gets the records as they are read.
        opened: the log, opened by the caller; where it must be read twice, then from the path.

    Raises:
        InputError: the file cannot be read as a log, or a prior needs a scale.
    """
    options = options or ChainOptions()
    if anchor is None and airframe.anchor() is None:
        airframe = airframe.in_own_units()

    def read(options: ChainOptions, opened: Log | None = None, *, again: bool = False) -> Chain:
        log = opened or open_log(path, wanted)
        chain = Chain(airframe, options, anchor, Origin(log, str(path), wanted))
        for observer in observers:
            observer.begin()
            chain.observers.append(observer.take)
        if keeper is not None:
            keeper.begin(log)
        if take_log(chain, log, keeper, progress, whole=again):
            return chain
        # A ground station that fetched the parameters in flight or after it: they held all along.
        return read(replace(options, parameters=dict(chain.rotor_selector.parameters)), again=True)

    chain = read(options, opened)
    result = chain.finish()
    for observer in observers:
        observer.end(chain)
    if keeper is not None:
        keeper.end(chain.sampler)
    return result


def take_log(
    chain: Chain,
    log: Log,
    keeper: RecordKeeper | None = None,
    progress: Callable[[float], None] | None = None,
    *,
    whole: bool = True,
) -> bool:
    """Give a chain a recording.

    The keeper gets the records first. `whole`: parameters that come too late for the estimate
    change nothing; else the chain takes but those of what follows them.

    Returns:
        Whether the chain took all of it.
    """
    done = 0.0
    blocks = _with_parameters_of_later(chain, log)
    for block, share in blocks:
        if keeper is not None:
            keeper.add_records(block)
        windows = [*block.windows(WINDOW)]
        for number, window in enumerate(windows):
            if progress:
                progress(done + (share - done) * number / len(windows))
            chain.take(window)
            if chain.outdated and not whole:
                for _ in blocks:
                    pass
                return False
        done = share
    if progress:
        progress(1.0)
    return True


def _with_parameters_of_later(
    chain: Chain, log: Log, most: int = 8
) -> Iterator[tuple[RecordBlock, float]]:
    """Blocks of a log, each with the share read up to its end.

    A ground station fetches the parameters soon after it connects: known before the samples, they
    spare most logs that the estimate starts again. At most `most` blocks are kept waiting, some 2
    MB each.
    """
    waiting: deque[tuple[RecordBlock, float]] = deque()
    for block in log.blocks():
        chain.learn_parameters(block)
        waiting.append((block, log.share_read))
        if len(waiting) > most:
            yield waiting.popleft()
    yield from waiting


def aligned_samples(log: Log, airframe: Airframe) -> Iterator[SampleBlock]:
    """The samples that an analysis would take, without an estimate."""
    selector = RotorSourceSelector(airframe, None)
    sampler = Sampler(selector, len(airframe.rotors), imu_arm=airframe.imu_arm)
    for block in log.blocks():
        if log.vehicle is not None:
            selector.autopilot = log.vehicle.key
        yield from sampler.feed_records(block)
    yield from sampler.finish()


def analyze_pair(
    paths: tuple[Path, Path],
    added_mass: float,
    airframe: Airframe,
    wanted: tuple[int, int | None] | None = None,
    options: ChainOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Result]:
    """Identify from two flights of one vehicle, the second with a known mass added.

    `added_mass` is kg; the airframe's anchor does not count.

    Raises:
        InputError: a file cannot be read, or the flights cannot separate the masses.
    """
    unit = ScaleReference("mass", 1.0)
    cheap = replace(options or ChainOptions(), history_interval=None, offline=False)
    per_mass = [
        analyze_log(path, airframe, wanted, cheap, progress, unit).parameters["k_T"]
        for path in paths
    ]
    (light, light_std), (heavy, heavy_std) = ((k.value, k.std) for k in per_mass)
    if light is None or heavy is None or light_std is None or heavy_std is None:
        raise InputError(
            f"{paths[0]} and {paths[1]}: thrust over mass is not observable from both: "
            "one flight is too short"
        )
    if light - heavy < 3.0 * math.hypot(light_std, heavy_std):
        raise InputError(
            f"{paths[1]} is not heavier than {paths[0]}: "
            "give the light flight first, or add more mass"
        )
    given = airframe.uncertainty.scale_share("added_mass", added_mass)
    first = analyze_log(
        paths[0],
        airframe,
        wanted,
        options,
        progress,
        ScaleReference("added_mass", added_mass, loaded=(heavy, heavy_std), given=given),
    )
    k_T = first.parameters["k_T"]
    assert k_T.value is not None
    assert k_T.std_data is not None
    origin = f"two flights, {added_mass:g} kg apart"
    shared = ScaleReference("k_T", k_T.value, k_T.std_data, origin, given=given)
    return [first, analyze_log(paths[1], airframe, wanted, options, progress, shared)]
