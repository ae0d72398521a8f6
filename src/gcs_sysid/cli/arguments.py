"""The options of every command, and their checks."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcs_sysid.argument_types import (
    AppendNamed,
    baud,
    between,
    measured,
    not_negative,
    number,
    positive,
    split_prior,
)
from gcs_sysid.cli import option_groups
from gcs_sysid.errors import InputError
from gcs_sysid.files import with_mapping

ARTICLE_METHODS = ("article", "article-usual-td", "article-stepwise", "central-difference")
"""Names of `estimation.record.article_estimator.METHODS` (a test compares); not imported:
that would start slowly."""

EXPORT_TARGETS = (
    "px4-sih", "gazebo-sdf", "urdf", "mjcf", "rotorpy", "ardupilot-sitl", "crazyflow", "l2f",
    "indiflight", "paparazzi",
)  # fmt: skip
"""Names of `exports.formats.TARGETS` (a test compares); not imported either."""

NO_SCALE = (
    "nothing sets the scale: weigh the vehicle and give --mass KG (or --k-t VALUE, or "
    "--t-max VALUE with commands); IMU and rotor data alone fix ratios only"
)

_Group = argparse._ArgumentGroup

if TYPE_CHECKING:
    from gcs_sysid.model.airframe import Airframe


def vehicle_address(text: str) -> tuple[int, int | None]:
    """An argparse type: SYSID or SYSID:COMPID."""
    system, _, component = text.partition(":")
    try:
        address = int(system), int(component) if component else None
    except ValueError:
        address = (0, None)
    if not 1 <= address[0] <= 255 or not (address[1] is None or 0 <= address[1] <= 255):
        raise argparse.ArgumentTypeError(
            f"must be SYSID or SYSID:COMPID with numbers up to 255, got {text!r}"
        )
    return address


SCALE_OPTIONS = {
    "arm": ("--arm", "arm"),
    "mass": ("--mass", "mass"),
    "k_t": ("--k-t", "k_T"),
    "t_max": ("--t-max", "T_max"),
}
"""Attribute -> option and key of `[uncertainty]`, of those that may have a standard deviation."""

mass = between(0.001, 1e5, "kg")
"""Of something that flies."""
rate = between(1.0, 2000.0, "Hz")
"""Of messages."""


def rotors(text: str) -> int:
    """An argparse type: how many rotors."""
    if not text.isdecimal() or not 3 <= int(text) <= 32:
        raise argparse.ArgumentTypeError(f"must be a whole number from 3 to 32, got {text!r}")
    return int(text)


def prior(text: str) -> tuple[str, float, float]:
    """An argparse type: NAME=VALUE±STD; +- and +/- do as well."""
    words = split_prior(text)
    try:
        if words:
            return words[0], float(words[1]), float(words[2])
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"must be NAME=VALUE±STD (or +-), got {text!r}")


def setting(text: str) -> tuple[str, float]:
    """An argparse type: NAME=VALUE."""
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE, got {text!r}")
    return name.strip(), number(value)


_REPORTED = "default auto: the layout in the vehicle's parameters"


def _add_layout(
    parser: argparse.ArgumentParser, unnamed: str = "", default: str | None = None
) -> _Group:
    """Options of the airframe and its scale.

    Args:
        parser: of the command.
        unnamed: what the command does without an airframe, in words.
        default: the airframe that it takes.
    """
    group = parser.add_argument_group("vehicle and scale")
    group.add_argument(
        "--airframe",
        metavar="NAME|FILE",
        default=default,
        help="built-in name (paper, px4-quad-x, ...) or .toml file"
        + (f" ({unnamed})" if unnamed else ""),
    )
    group.add_argument(
        "--arm",
        type=measured(positive),
        metavar="M[±STD]",
        help="mean distance of the rotors from the center, m; here and below "
        "+- adds a standard deviation: 0.25+-0.003 or 0.25+-1%% (default 1%%)",
    )
    scale = group.add_mutually_exclusive_group()
    scale.add_argument(
        "--mass",
        type=measured(mass),
        metavar="KG[±STD]",
        help="weighed mass as the scale (default +-0.5%%)",
    )
    scale.add_argument(
        "--k-t",
        type=measured(positive),
        metavar="N_S2[±STD]",
        help="known k_T as the scale (default +-2%%)",
    )
    scale.add_argument(
        "--t-max",
        type=measured(positive),
        metavar="N[±STD]",
        help="known thrust of a rotor at full command (default +-2%%)",
    )
    return group


def _add_airframe(
    parser: argparse.ArgumentParser, unnamed: str = "", default: str | None = None
) -> None:
    _add_layout(parser, unnamed, default).add_argument(
        "--prior",
        type=prior,
        action=AppendNamed,
        default=[],
        metavar="NAME=VALUE±STD",
        help="prior, such as k_M=6.1e-6+-1e-7 from a bench test; may be repeated",
    )


def _add_csv(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--csv",
        metavar="MAPPING.toml",
        help="what the columns of .csv and .parquet LOGs mean (default: columns.toml beside them)",
    )


def with_mappings(options: argparse.Namespace) -> None:
    """Name the mapping of `--csv` with each table among the logs."""
    if getattr(options, "csv", None) is None:
        return
    mapping = Path(options.csv)
    if not mapping.is_file():
        raise InputError(f"--csv {mapping}: no such file")
    if getattr(options, "logs", None):
        options.logs = [str(with_mapping(Path(log), mapping)) for log in options.logs]
    for name in ("log", "target", "result"):
        if getattr(options, name, None):
            setattr(options, name, str(with_mapping(Path(getattr(options, name)), mapping)))


def _add_force(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--force", action="store_true", help="overwrite existing files")


def _add_baseline(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--baseline", metavar="RESULT.json", help="earlier result to compare with on the screen"
    )


def web_address(text: str) -> tuple[str, int]:
    """An argparse type: [HOST:]PORT; without a host, this machine alone."""
    host, colon, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    host = host.strip("[]") if colon else "127.0.0.1"
    if not host or (":" in host and not bracketed) or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(
            f"must be [HOST:]PORT, such as 8000 or 0.0.0.0:8000, got {text!r}"
        )
    return host, int(port)


LOCAL_PAGE = ("127.0.0.1", 8000)
"""Where a page is served by default."""


def add_web(parser: argparse.ArgumentParser) -> None:
    """Options of `web`."""
    parser.add_argument(
        "address",
        nargs="?",
        type=web_address,
        default=LOCAL_PAGE,
        metavar="[HOST:]PORT",
        help="address to serve on (default 8000, this machine only)",
    )


def _add_display(parser: argparse.ArgumentParser) -> None:
    """Where a session is shown."""
    parser.add_argument("--headless", action="store_true", help="print instead of the screen")
    parser.add_argument("--pilot", action="store_true", help="begin with the coach in large print")
    sound = parser.add_mutually_exclusive_group()
    sound.add_argument(
        "--speak",
        action="store_true",
        help="announce maneuvers, link and verdict by spd-say, espeak-ng or say, else the bell",
    )
    sound.add_argument("--bell", action="store_true", help="ring the terminal's bell for them")
    parser.add_argument(
        "--web",
        nargs="?",
        type=web_address,
        const=LOCAL_PAGE,
        metavar="[HOST:]PORT",
        help="serve a page for browsers (default 8000, this machine only)",
    )
    parser.add_argument("--json", metavar="FILE", help="snapshots, one per line; - is stdout")
    _add_force(parser)
    _add_baseline(parser)


def add_demo(parser: argparse.ArgumentParser) -> None:
    """Options of `demo`."""
    _add_airframe(parser, "default paper", "paper")
    parser.add_argument(
        "--speed", choices=("1", "max"), default="1", help="1: real time; max: as fast as possible"
    )
    parser.add_argument(
        "--mission",
        choices=("paper", "all-axes", "hover"),
        default="all-axes",
        help="what the emulator flies: the article's maneuvers, every axis at once, or hover alone "
        "(default all-axes)",
    )
    parser.add_argument(
        "--noise",
        choices=("none", "paper", "white", "mems"),
        default="mems",
        help="sensor noise (default mems)",
    )
    parser.add_argument(
        "--sigma", type=not_negative, help="noise of paper and white, rad and rad/s"
    )
    parser.add_argument(
        "--rate",
        type=rate,
        default=250.0,
        metavar="HZ",
        help="message rate of IMU and rotors (default 250)",
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="seed of all randomness (default 1)"
    )
    parser.add_argument("--duration", type=positive, metavar="S", help="length of the flight")
    parser.add_argument("--mass-step", metavar="T:FACTOR", help="change the mass in flight")
    parser.add_argument("--record", metavar="FILE", help="record the flight to a .tlog")
    _add_display(parser)
    option_groups.add_options(parser)


def _add_vehicle_choice(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--vehicle",
        type=vehicle_address,
        metavar="SYSID[:COMPID]",
        help="if there are several (default: the first autopilot received)",
    )


def _add_link(group: argparse._ActionsContainer) -> None:
    group.add_argument(
        "--baud",
        type=baud,
        metavar="N",
        help="serial baud rate (default 115200); limits the message rates",
    )
    group.add_argument("--listen-only", action="store_true", help="send nothing")
    group.add_argument(
        "--rate",
        type=rate,
        default=250.0,
        metavar="HZ",
        help="message rate to request (default 250)",
    )
    group.add_argument(
        "--signing-key",
        metavar="FILE",
        help="MAVLink 2 signing: 32 bytes, 64 hexadecimal digits or a line with the passphrase; "
        "unsigned frames are rejected",
    )


def add_live(parser: argparse.ArgumentParser) -> None:
    """Options of `live`."""
    parser.add_argument("url", metavar="URL", help="such as udpin:0.0.0.0:14550")
    _add_airframe(parser, _REPORTED)
    parser.add_argument("--record", metavar="FILE", help="default: a dated .tlog under logs/")
    parser.add_argument("--no-record", action="store_true", help="do not record")
    _add_link(parser)
    _add_vehicle_choice(parser)
    parser.add_argument("--duration", type=positive, metavar="S", help="stop after S seconds")
    parser.add_argument(
        "--truth", metavar="FILE", help="true parameters, shown beside the estimates"
    )
    _add_display(parser)
    option_groups.add_options(parser)


def add_replay(parser: argparse.ArgumentParser) -> None:
    """Options of `replay`."""
    parser.add_argument("log", metavar="LOG", help="a .tlog, .ulg, .bin, .bbl or .csv file")
    _add_csv(parser)
    _add_airframe(parser)
    _add_vehicle_choice(parser)
    parser.add_argument(
        "--speed", choices=("1", "10", "max"), default="1", help="initial speed (default 1)"
    )
    parser.add_argument(
        "--truth", metavar="FILE", help="true parameters, shown beside the estimates"
    )
    option_groups.add_target(parser)
    _add_display(parser)


def add_analyze(parser: argparse.ArgumentParser) -> None:
    """Options of `analyze`."""
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help=".tlog, .ulg, .bin, .bbl, .csv or .parquet file; several: each by itself",
    )
    _add_csv(parser)
    _add_airframe(parser, _REPORTED)
    parser.add_argument("--json", metavar="FILE", help="write the result; - is stdout")
    parser.add_argument("--report", metavar="FILE.html", help="write an HTML report with figures")
    _add_force(parser)
    parser.add_argument(
        "--start",
        type=not_negative,
        default=0.0,
        metavar="S",
        help="use the log from S seconds after its beginning (default 0)",
    )
    parser.add_argument(
        "--end",
        type=positive,
        default=math.inf,
        metavar="S",
        help="use the log up to S seconds after its beginning (default: all of it)",
    )
    _add_vehicle_choice(parser)
    parser.add_argument(
        "--truth", metavar="FILE", help="true parameters, shown beside the estimates"
    )
    parser.add_argument(
        "--added-mass",
        type=mass,
        metavar="KG",
        help="set the scale from two flights, the second with KG of added mass",
    )
    parser.add_argument(
        "--offline",
        action="store_true",
        help="filter error or maximum likelihood over the whole record, with the Cramer-Rao bound "
        "(slower)",
    )
    parser.add_argument(
        "--method",
        choices=("forward", "forward-td", "forward-window", *ARTICLE_METHODS),
        default="forward",
        help="forward: whitened rows, or the window for slow data (default); forward-td, "
        "forward-window: a tracking differentiator or the window throughout; others: the article's "
        "method and variants, for study",
    )


def add_inspect(parser: argparse.ArgumentParser) -> None:
    """Options of `inspect`."""
    # Left out by `inspect --json LOG`, see the command.
    parser.add_argument(
        "target", nargs="?", metavar="LOG|URL", help="a log, or a link such as udpin:0.0.0.0:14550"
    )
    _add_csv(parser)
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        help="print JSON instead of text, or also write it to FILE",
    )
    _add_force(parser)
    _add_vehicle_choice(parser)
    _add_layout(parser, "default: the rotors by the vehicle's type").add_argument(
        "--rotors",
        type=rotors,
        metavar="N",
        help="number of rotors, if neither --airframe nor the vehicle type defines it",
    )
    link = parser.add_argument_group("link")
    link.add_argument(
        "--duration",
        type=positive,
        default=10.0,
        metavar="S",
        help="listen for S seconds after the first message of the vehicle (default 10)",
    )
    _add_link(link)


def add_plan(parser: argparse.ArgumentParser) -> None:
    """Options of `plan`."""
    _add_airframe(parser)
    option_groups.add_plan(parser)


def add_export(parser: argparse.ArgumentParser) -> None:
    """Options of `export`."""
    parser.add_argument(
        "result", metavar="RESULT.json|LOG", help="written by --json; with --signals, a log"
    )
    parser.add_argument("--to", choices=EXPORT_TARGETS, help="target format")
    parser.add_argument("-o", "--output", metavar="FILE", help="output file; - is stdout")
    parser.add_argument("--force", action="store_true", help="overwrite FILE")
    group = parser.add_argument_group("signals of a flight, instead of a vehicle")
    group.add_argument(
        "--signals",
        metavar="FILE",
        help="write aligned signals and residuals of LOG, as .csv, .parquet or .mcap, for "
        "PlotJuggler, Foxglove or MATLAB; needs --airframe and a scale",
    )
    _add_csv(group)
    _add_vehicle_choice(group)
    scale = group.add_mutually_exclusive_group()
    scale.add_argument("--mass", type=measured(mass), metavar="KG[±STD]", help="as for analyze")
    scale.add_argument(
        "--k-t", type=measured(positive), metavar="N_S2[±STD]", help="as for analyze"
    )
    scale.add_argument("--t-max", type=measured(positive), metavar="N[±STD]", help="as for analyze")
    add_vehicle_name(parser)
    parser.add_argument(
        "--ensemble",
        type=draws,
        metavar="N",
        help="N vehicles drawn from the covariance, as FILE-001, FILE-002, ...",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of --ensemble (default 1)")
    add_other_values(parser, setting, "NAME=VALUE", "rotor_speed_max=900 or Ixy=0")


def add_vehicle_name(parser: argparse.ArgumentParser) -> None:
    """`--name`, of what is written."""
    parser.add_argument(
        "--name", metavar="NAME", help="name of the vehicle (default: the airframe's)"
    )


def add_other_values(
    parser: argparse.ArgumentParser, read: Callable[[str], Any], metavar: str, example: str
) -> None:
    """Options for what a result does not have.

    Args:
        parser: of a command that reads a result.
        read: argparse type of `--set`.
        metavar: of the same.
        example: of the same, in its help.
    """
    group = parser.add_argument_group("values that the flight did not identify")
    group.add_argument(
        "--set",
        type=read,
        action=AppendNamed,
        default=[],
        metavar=metavar,
        help=f"a value from elsewhere, SI, such as {example}; may be repeated",
    )
    group.add_argument(
        "--airframe",
        metavar="NAME|FILE",
        help="supplies [prior], scale, and rotors if the result has none",
    )
    group.add_argument(
        "--arm", type=positive, metavar="M", help="mean distance of the rotors from the center, m"
    )


def draws(text: str) -> int:
    """An argparse type: how many draws."""
    if not text.isdecimal() or not 1 <= int(text) <= 10_000:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 to 10000, got {text!r}")
    return int(text)


def add_compare(parser: argparse.ArgumentParser) -> None:
    """Options of `compare`."""
    parser.add_argument("before", metavar="A.json", help="result written by --json")
    parser.add_argument("after", metavar="B.json", help="another result of the same vehicle")
    parser.add_argument("--json", metavar="FILE", help="write the comparison; - is stdout")
    _add_force(parser)


def add_twin(parser: argparse.ArgumentParser) -> None:
    """Options of `twin`."""
    parser.add_argument(
        "result", metavar="RESULT", help="result written by --json, or another log of the vehicle"
    )
    parser.add_argument("log", metavar="LOG", help="flight to fly the model along")
    parser.add_argument("--json", metavar="FILE", help="write the errors; - is stdout")
    parser.add_argument("--picture", metavar="FILE.svg", help="draw how the errors grow")
    _add_force(parser)
    _add_airframe(parser, "default: the result's; auto: the layout in the vehicle's parameters")
    _add_vehicle_choice(parser)
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="seed of the vehicles drawn from the covariance (default 0)",
    )


def _workers(text: str) -> int:
    """An argparse type: how many processes."""
    if not text.isdecimal() or not 1 <= int(text) <= 1024:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 to 1024, got {text!r}")
    return int(text)


def add_batch(parser: argparse.ArgumentParser) -> None:
    """Options of `batch`."""
    parser.add_argument(
        "logs", nargs="+", metavar="PATH", help="a log, or a folder searched for logs"
    )
    _add_csv(parser)
    parser.add_argument(
        "-o", "--output", metavar="DIR", required=True, help="folder for results and table"
    )
    parser.add_argument(
        "--force", action="store_true", help="redo every log and overwrite existing files"
    )
    processes = parser.add_mutually_exclusive_group()
    processes.add_argument(
        "--workers",
        type=_workers,
        metavar="N",
        help="number of processes (default: one per processor)",
    )
    processes.add_argument(
        "--scheduler", metavar="URL", help="run on a Dask cluster, such as tcp://10.0.0.1:8786"
    )
    parser.add_argument(
        "--log-timeout",
        type=between(0.01, 1e6, "s"),
        default=1800.0,
        metavar="S",
        help="time limit for one log (default 1800)",
    )
    parser.add_argument(
        "--log-memory",
        type=between(10.0, 1e6, "MB"),
        default=4000.0,
        metavar="MB",
        help="memory limit for one log, on Linux (default 4000)",
    )
    _add_airframe(parser, "default: the nearest airframe.toml")
    _add_vehicle_choice(parser)
    parser.add_argument(
        "--offline", action="store_true", help="maximum likelihood over whole records (slower)"
    )


def add_trend(parser: argparse.ArgumentParser) -> None:
    """Options of `trend`."""
    parser.add_argument("fleet", metavar="DIR|FILE.parquet", help="output of batch")
    parser.add_argument("-o", "--output", metavar="FILE.html", required=True, help="output file")
    parser.add_argument("--force", action="store_true", help="overwrite FILE")


def add_health(parser: argparse.ArgumentParser) -> None:
    """Options of `health`."""
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help=".tlog, .ulg, .bin, .bbl, .csv; several: of one vehicle",
    )
    _add_csv(parser)
    _add_layout(parser, "default: by the vehicle's parameters or type").add_argument(
        "--battery-mass",
        type=mass,
        metavar="KG",
        help="battery mass: shows how far to move it to center the CG",
    )
    _add_vehicle_choice(parser)
    parser.add_argument(
        "--baseline",
        metavar="HEALTH.json",
        help="earlier flight, written by --json, to find a rotor that has weakened since "
        "(default: the first of several logs)",
    )
    parser.add_argument(
        "--unchanged",
        action="store_true",
        help="nothing was moved or loaded since the baseline: a weak rotor is detected sooner",
    )
    parser.add_argument("--json", metavar="FILE", help="write the findings; - is stdout")
    parser.add_argument(
        "--params",
        metavar="FILE",
        help="suggested autopilot parameters: .params for QGroundControl, .param for Mission "
        "Planner; nothing is sent to a vehicle",
    )
    parser.add_argument("--picture", metavar="FILE.svg", help="the vehicle from above, on a page")
    _add_force(parser)


def layout_of(options: argparse.Namespace, reported: "Airframe | None" = None) -> "Airframe":
    """The airframe that is named, or the one reported, with the scale that is given, if any.

    Raises:
        InputError: there is none of that name, or it is no airframe.
    """
    from gcs_sysid.model.airframe import load_airframe

    airframe = load_airframe(options.airframe) if reported is None else reported
    if options.arm is not None:
        airframe = airframe.with_arm(options.arm)
    for name in SCALE_OPTIONS:
        sigma = getattr(getattr(options, name), "sigma", None)
        if sigma is not None:
            option, key = SCALE_OPTIONS[name]
            airframe = airframe.with_uncertainty({key: sigma}, option)
    if options.mass is not None:
        return airframe.with_anchor("mass", options.mass)
    if options.k_t is not None:
        return airframe.with_anchor("k_T", options.k_t)
    if options.t_max is not None:
        return airframe.with_anchor("T_max", options.t_max)
    return airframe


def is_auto(options: argparse.Namespace) -> bool:
    """Whether the layout comes from the vehicle."""
    return options.airframe in (None, "auto")


def check_scale_given(options: argparse.Namespace) -> None:
    """See that something sets the scale of an airframe that the vehicle reports.

    Raises:
        InputError: nothing does.
    """
    if not is_scale_given(options):
        also = "" if options.arm is not None else "; most vehicles also need --arm M"
        raise InputError(f"{NO_SCALE}; without --airframe the layout comes from the vehicle{also}")


def is_scale_given(options: argparse.Namespace) -> bool:
    """Whether an option sets the scale."""
    given = (options.mass, options.k_t, options.t_max, getattr(options, "added_mass", None))
    return given.count(None) < len(given)


def airframe_of(options: argparse.Namespace, reported: "Airframe | None" = None) -> "Airframe":
    """The airframe with its anchor, as the options say.

    Args:
        options: of the command line.
        reported: the layout that the vehicle reports, which replaces `--airframe`.

    Raises:
        InputError: there is none, or nothing sets the scale.
    """
    from gcs_sysid.model.airframe import builtin_names

    if reported is None and is_auto(options):
        raise InputError(
            "which airframe? Give --airframe FILE.toml or one of "
            + ", ".join(builtin_names())
            + " (with --arm for its size)"
        )
    airframe = layout_of(options, reported)
    given = (options.mass, options.k_t, options.t_max)
    if given.count(None) == len(given) and getattr(options, "added_mass", None) is not None:
        # Of the two flights; until they are compared any mass does.
        airframe = airframe.with_anchor("mass", 1.0)
    for name, value, std in options.prior:
        airframe = airframe.with_prior(name, value, std)
    if airframe.anchor() is None:
        raise InputError(NO_SCALE)
    airframe.check_scale_fits()
    return airframe
