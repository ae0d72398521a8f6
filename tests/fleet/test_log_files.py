"""Which files are logs, and whose airframe."""

import os
import struct
import sys

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.fleet.batch import find_logs, nearest_airframe


@pytest.mark.slow
def test_content_or_name_makes_a_log(logs):
    found = [path.relative_to(logs).as_posix() for path in find_logs([logs])]
    assert found == [
        *("one/a.tlog", "one/b.tlog", "one/copy without a suffix"),
        *("two/a.tlog", "two/broken.ulg"),
    ]


@pytest.mark.parametrize("head", [b"ULog\x01\x12\x35\x01", b"\xa3\x95\x80"])
def test_onboard_logs_are_told_by_content(tmp_path, head):
    (tmp_path / "00000012").write_bytes(head + bytes(100))
    (tmp_path / "other").write_bytes(struct.pack(">Q", 1) + b"\xfd" + bytes(100))
    assert find_logs([tmp_path]) == [tmp_path / "00000012"]


def test_a_file_that_is_named_counts_and_every_log_once(logs):
    notes = logs / "two" / "notes.txt"
    found = find_logs([notes, logs / "two" / "a.tlog", logs])
    assert found[:2] == [notes, logs / "two" / "a.tlog"]
    assert len(found) == 6


def test_what_begins_with_a_dot_is_passed_over(tmp_path):
    (tmp_path / ".trash").mkdir()
    for name in (".trash/a.tlog", ".b.tlog", "c.tlog"):
        (tmp_path / name).write_bytes(b"")
    assert find_logs([tmp_path]) == [tmp_path / "c.tlog"]


def test_a_path_that_is_not_there_is_told(tmp_path):
    with pytest.raises(InputError, match=r"gone: no such file or folder"):
        find_logs([tmp_path / "gone"])


@pytest.mark.skipif(sys.platform == "win32", reason="no such pipes there")
def test_a_pipe_that_is_named_is_refused_and_one_in_a_folder_passed_over(tmp_path):
    os.mkfifo(tmp_path / "a.tlog")
    with pytest.raises(InputError, match="pipe or a device"):
        find_logs([tmp_path / "a.tlog"])
    assert find_logs([tmp_path]) == []


def test_the_nearest_airframe_counts(tmp_path):
    near = tmp_path / "fleet" / "quad"
    (near / "march").mkdir(parents=True)
    for folder in (tmp_path / "fleet", near):
        (folder / "airframe.toml").touch()
    assert nearest_airframe(near / "march" / "a.tlog") == near / "airframe.toml"
    assert nearest_airframe(tmp_path / "fleet" / "b.tlog") == tmp_path / "fleet" / "airframe.toml"
