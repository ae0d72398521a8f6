"""Whole or not at all, and over nothing."""

import os
import sys
import threading
import time

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.files import check_target, read_bytes, write_whole


def test_writes_a_new_file_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "flight.html"
    check_target(path, replace=False)
    write_whole(path, "ä\n", replace=False)
    assert path.read_bytes() == "ä\n".encode()
    assert os.listdir(tmp_path) == ["flight.html"]


@pytest.mark.skipif(sys.platform == "win32", reason="no such modes there")
def test_text_with_a_name_that_is_no_utf8_is_written(tmp_path):
    path = tmp_path / "report.html"
    write_whole(path, "of bad\udcff.tlog", replace=False)
    assert path.read_text("utf-8") == "of bad\\udcff.tlog"


def test_never_replaces_a_file_unasked(tmp_path):
    path = tmp_path / "flight.html"
    path.write_text("mine")
    with pytest.raises(InputError, match="--force"):
        check_target(path, replace=False)
    with pytest.raises(InputError, match="--force"):  # one that came meanwhile
        write_whole(path, "new", replace=False)
    assert path.read_text() == "mine"
    assert os.listdir(tmp_path) == ["flight.html"]


def test_a_failure_leaves_the_old_file(tmp_path):
    path = tmp_path / "flight.html"
    path.write_text("mine")
    with pytest.raises(TypeError):
        write_whole(path, 3, replace=True)  # type: ignore[arg-type]
    assert path.read_text() == "mine"
    assert os.listdir(tmp_path) == ["flight.html"]


@pytest.mark.parametrize("name", ["no/such/folder.html", "."])
def test_says_beforehand_that_it_cannot_be_written(tmp_path, name):
    with pytest.raises(InputError, match="cannot write"):
        check_target(tmp_path / name, replace=True)


def test_never_replaces_what_is_read(tmp_path):
    log = tmp_path / "flight.tlog"
    log.write_bytes(b"x")
    with pytest.raises(InputError, match="another file"):
        check_target(tmp_path / "." / "flight.tlog", replace=True, sources=(log,))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_a_pipe_without_a_writer_is_given_up(tmp_path, monkeypatch):
    pipe = tmp_path / "result.json"
    os.mkfifo(pipe)
    monkeypatch.setattr("gcs_sysid.files._WRITER_WITHIN", 0.01)
    with pytest.raises(InputError, match="cannot read the result: a pipe without a writer"):
        read_bytes(pipe, "the result", 100)

    def write_late() -> None:
        with open(pipe, "wb", buffering=0) as file:
            time.sleep(0.1)  # longer than nobody is waited for
            file.write(b"{}")

    monkeypatch.setattr("gcs_sysid.files._WRITER_WITHIN", 60.0)
    # Open to read, so that the writer below need not wait for it to be opened.
    held = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    writer = threading.Thread(target=write_late)
    writer.start()
    assert read_bytes(pipe, "the result", 100) == b"{}"
    writer.join()
    os.close(held)
