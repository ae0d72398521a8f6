"""Analysis of recorded flights."""

from collections.abc import Callable
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.session.result import Result
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.tlog import read_tlog

_FRAMES_AT_ONCE = 4096


def analyze_log(
    path: Path,
    airframe: Airframe,
    wanted: tuple[int, int | None] | None = None,
    options: ChainOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Result:
    """Identify from a recording.

    Args:
        path: a .tlog file.
        airframe: with a scale anchor.
        wanted: system and perhaps component; None: the first autopilot in the log.
        options: of the chain; by default the estimate's course is not computed.
        progress: called with the share of the log done, 0 to 1, now and then.

    Raises:
        InputError: the file cannot be read as a log.
    """
    if path.suffix.lower() in (".ulg", ".bin"):
        raise InputError(f"{path}: {path.suffix} logs cannot be read yet; give a .tlog")
    pipeline = Pipeline(airframe, str(path), wanted, options or ChainOptions(course_interval=None))
    reader = read_tlog(path)
    size = max(path.stat().st_size, 1)
    done = 0
    frames: list[Frame] = []
    for _, frame in reader:
        frames.append(frame)
        done += 8 + len(frame.raw)
        if len(frames) >= _FRAMES_AT_ONCE:
            pipeline.take(frames)
            frames.clear()
            if progress:
                progress(done / size)
    pipeline.take(frames)
    pipeline.intake.garbage_bytes = reader.garbage_bytes
    if progress:
        progress(1.0)
    return pipeline.finish()
