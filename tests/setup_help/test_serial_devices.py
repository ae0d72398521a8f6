"""Serial devices and permissions, as each system has them."""

import os
import sys

import pytest

from gcs_sysid.setup_help.checks import Sign, check_serial
from gcs_sysid.telemetry.link import SerialDevice

RADIO = SerialDevice("/dev/ttyUSB97", "FT232R USB UART")
posix = pytest.mark.skipif(sys.platform == "win32", reason="groups of POSIX")


class Group:
    """As `grp` has it."""

    def __init__(self, name, gid, members=()):
        self.gr_name, self.gr_gid, self.gr_mem = name, gid, list(members)


@pytest.fixture
def user(monkeypatch):
    """Somebody on Linux: `user(in_session=..., in_file=...)`; the port's group is dialout."""

    def make(*, in_session, in_file=False):
        import grp
        import pwd

        me = pwd.getpwuid(os.getuid()).pw_name
        dialout = Group("dialout", 20, [me] if in_file else [])
        by_name = {"dialout": dialout}
        monkeypatch.setattr(grp, "getgrnam", by_name.__getitem__)
        monkeypatch.setattr(os, "geteuid", lambda: 1000)
        monkeypatch.setattr(os, "getegid", lambda: 1000)
        monkeypatch.setattr(os, "getgroups", lambda: [1000, *([20] if in_session else [])])

    return make


@posix
def test_a_linux_user_outside_dialout_gets_the_line_to_run(user):
    user(in_session=False)
    for devices in ([RADIO], []):
        (finding,) = check_serial(devices, "Linux")
        assert finding.sign is (Sign.PROBLEM if devices else Sign.WARNING)
        assert list(finding.advice) == [
            "sudo usermod -aG dialout $USER",
            "then log out and in again",
        ]


@posix
def test_a_port_of_the_board_is_no_problem_of_somebody_who_flies_by_network(user):
    user(in_session=False)
    (finding,) = check_serial([SerialDevice("/dev/ttyS97", "", usb=False)], "Linux")
    assert finding.sign is Sign.WARNING
    assert finding.text == "on-board port, no permission to open it"


@posix
def test_who_has_joined_but_not_logged_in_again(user):
    user(in_session=False, in_file=True)
    (finding,) = check_serial([RADIO], "Linux")
    assert "log out and in again" in finding.advice[0]
    assert "usermod" not in finding.advice[0]


@posix
def test_who_may_open_it(user, tmp_path):
    user(in_session=True)
    device = tmp_path / "ttyACM0"
    device.touch()
    (finding,) = check_serial([SerialDevice(str(device), "")], "Linux")
    assert finding.sign is Sign.OK
    assert finding.advice == [f"gcs-sysid live {device} --airframe FILE.toml"]
    (finding,) = check_serial([], "Linux")
    assert (finding.sign, "/dev/ttyACM0" in finding.advice[0]) == (Sign.OK, True)


@pytest.mark.parametrize(
    ("system", "name", "said"),
    [("Windows", "COM3", "Device Manager"), ("Darwin", "/dev/cu.usbserial-1", "/dev/cu.")],
)
def test_windows_and_macos_have_their_own_words(system, name, said):
    (finding,) = check_serial([SerialDevice(name, "radio")], system)
    assert finding.sign is Sign.OK
    assert f"gcs-sysid live {name} --baud 57600" in finding.advice[0]
    assert said in finding.advice[1]
    (finding,) = check_serial([], system)
    assert said in finding.advice[0]
