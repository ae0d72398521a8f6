"""Recordings sent again, at their own pace."""

import struct
from pathlib import Path

import pytest

from gcs_sysid.telemetry.tlog import TlogReader
from sim_bridge.cli import main
from sim_bridge.playback import MOST_PAUSE, moments, play


class Sink:
    """A link that keeps what is sent, with the time when."""

    connected = True

    def __init__(self) -> None:
        self.now = 0.0
        self.sent: list[tuple[float, bytes]] = []

    def send(self, frames: list[bytes], time_us: int) -> None:
        self.sent += [(self.now, frame) for frame in frames]

    def receive(self) -> bytes:
        return b"whatever comes back is not answered"

    def close(self) -> None:
        pass


class Waits:
    """A pace whose clock is the sink's."""

    def __init__(self, sink: Sink) -> None:
        self.sink = sink

    def wait(self, flown: float) -> None:
        self.sink.now = flown


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "flight.tlog"
    assert main(["--tlog", str(path), "--duration", "3", "--rate", "20", "--trap", "radio"]) == 0
    return path


def restamped(path: Path, folder: Path, stamps: list[int]) -> Path:
    """The first frames of a recording under other times."""
    out = folder / "restamped.tlog"
    frames = [frame.raw for _, frame in TlogReader(path)][: len(stamps)]
    records = [struct.pack(">Q", t) + raw for t, raw in zip(stamps, frames, strict=True)]
    out.write_bytes(b"".join(records))
    return out


def test_every_frame_leaves_untouched_when_it_came(recording: Path) -> None:
    sink = Sink()
    records = list(TlogReader(recording))
    assert play(TlogReader(recording), sink, Waits(sink)) == len(records)
    assert [raw for _, raw in sink.sent] == [frame.raw for _, frame in records]
    first = records[0][0]
    wanted = [1e-6 * (time_us - first) for time_us, _ in records]
    assert [now for now, _ in sink.sent] == pytest.approx(wanted, abs=1e-9)
    assert wanted[-1] > 2.5


def test_time_never_goes_back_and_long_pauses_are_cut(recording: Path, tmp_path: Path) -> None:
    day = 86_400_000_000
    stamps = [day, day + 1000, day + 500, day + 500, day + 700, day + 700 + 3_600_000_000]
    path = restamped(recording, tmp_path, stamps)
    times = [flown for flown, _ in moments(TlogReader(path))]
    assert times == pytest.approx([0.0, 1e-3, 1e-3, 1.2e-3, 1.2e-3 + MOST_PAUSE])


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--play", "nonesuch.tlog"), "nonesuch.tlog"),
        (("--play", "LOG", "--tlog", "other.tlog"), "--play and --tlog exclude"),
        (("--play", "LOG", "--signing-key", "key"), "--play and --signing-key exclude"),
        (("--play", "LOG", "udp-out:1.2.3.4"), "cannot understand --connect"),
        (("udpout:127.0.0.1:1", "--connect", "udpout:127.0.0.1:1"), "give the URL once"),
    ],
)
def test_what_cannot_be_played_is_one_line(
    options: tuple[str, ...], why: str, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(recording) if word == "LOG" else word for word in options]) == 2
    told = capsys.readouterr().err
    assert why in told
    assert told.count("\n") == 1


def test_the_command_says_what_it_played(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Nobody listens there; datagrams do not mind.
    assert main(["--play", str(recording), "udpout:127.0.0.1:9", "--speed", "max"]) == 0
    count = sum(1 for _ in TlogReader(recording))
    assert f"played {count} frames" in capsys.readouterr().err
