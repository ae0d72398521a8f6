"""All harnesses."""

from testbed.fuzz import blackbox_harnesses as blackbox
from testbed.fuzz import body_harnesses as bodies
from testbed.fuzz import definition_harnesses as definitions
from testbed.fuzz import file_harnesses as files
from testbed.fuzz import link_harnesses as link
from testbed.fuzz.harness import Harness

_MAGICS = (b"\xfd", b"\xfe", b"\xfd\x09\x00\x00", b"\xfe\x09", b"\xfd\x01\x00\x00\x09\x01\x01\xff")
_JSON = (b"[", b"{", b"]", b"}", b'"', b":", b",", b"null", b"true", b"-", b"e", b"NaN", b"1e400")
_TOML = (*_JSON, *b"[[rotor]] = ' # inf nan x spin cw .".split(), b'"""', b"\n")
_WORDS = (*b": , = +- [ ] // udpin: tcp: COM1 /dev/tty".split(), b" ")
_TALK = (b"\n", b"\n\n", b"own\n", b"back\n", b"y\n", b"1\n", b"0.2 0.2 cw\n", b"inf", b" ccw")
_ULOG = (*b"float [ ] ; : D F A P I uint64_t".split(), b" ", b" timestamp")
_BBL = (
    *b"I P G H S E , : -1 0 1 3 6 7 8 9 10 11 256 1/4".split(), b"\n", b"H ", b"H Field I ",
    b"E\xff", b"E\x0e", b"\xff\xff\xff\xff\xff", b"\x80\x80\x80\x80\x00",
)  # fmt: skip
_BODY = (*b"I P G H S E".split(), *_BBL[-4:])
_FMT = (b"\xa3\x95", b"\xa3\x95\x80", b",", b"Q", b"a", b"Z", b"TimeUS", b"\x80\x59")

HARNESSES = (
    Harness(
        "frames", "frames of a stream", link.check_frames, link.stream_seeds, 6.0, _MAGICS, 600
    ),
    Harness(
        "datagrams", "frames of datagrams", link.check_datagrams, link.datagram_seeds, 6.0,
        _MAGICS, 600,
    ),
    Harness(
        "tlog-scan", "frames of a .tlog", link.check_tlog_scan, link.log_seeds, 1.5, _MAGICS, 400
    ),
    Harness("tlog", "a .tlog to records", link.check_tlog, link.tlog_seeds, 1.5, _MAGICS),
    Harness(
        "records", "MAVLink to records", link.check_records, link.program_seeds, 1.0, (), 200
    ),
    Harness(
        "answers", "frames to our answers", link.check_answers, link.program_seeds, 1.5, (), 200
    ),
    Harness(
        "signatures", "signed frames", link.check_signatures, link.program_seeds, 4.0, (), 200
    ),
    Harness(
        "remote-logs", "answers about logs", link.check_remote_logs, link.remote_log_seeds, 1.0,
        (b"@MAV_LOG", b"Dlog\t", b"Fx\t9", b"\xff\xff\xff\xff"), 300,
    ),
    Harness("ulg", "logs of PX4", files.check_ulg, files.ulg_seeds, 4.0, _ULOG, 4096),
    Harness("bin", "logs of ArduPilot", files.check_bin, files.bin_seeds, 3.0, _FMT, 4096),
    Harness(
        "rosbag", "recordings of ROS 2", files.check_rosbag, files.rosbag_seeds, 3.0, (), 65_536
    ),
    Harness("log", "logs of any format", files.check_log, files.packed_seeds, 1.0, _FMT, 4096),
    Harness("bbl", "blackbox logs", blackbox.check_bbl, blackbox.bbl_seeds, 3.0, _BBL, 4096),
    Harness(
        "bbl-bodies", "frames behind a header", blackbox.check_bbl_bodies,
        blackbox.bbl_body_seeds, 12.0, _BODY, 60, 32,
    ),
    Harness(
        "ulg-bodies", "entries of .ulg", bodies.check_ulg_bodies, bodies.ulg_body_seeds, 12.0,
        _ULOG, 80, 32,
    ),
    Harness(
        "bin-bodies", "entries of .bin", bodies.check_bin_bodies, bodies.bin_body_seeds, 12.0,
        _FMT, 120, 32,
    ),
    Harness(
        "ulg-definitions", "formats of .ulg", definitions.check_ulg_definitions,
        definitions.choices, 3.0, (), 600,
    ),
    Harness(
        "bin-definitions", "FMT entries of .bin", definitions.check_bin_definitions,
        definitions.choices, 3.0, (), 600,
    ),
    Harness(
        "bbl-definitions", "headers of .bbl", definitions.check_bbl_definitions,
        definitions.choices, 1.0, (), 600,
    ),
    Harness(
        "bbl-frames", "frames of .bbl", blackbox.check_bbl_frames, definitions.choices, 1.0,
        (), 2000,
    ),
    Harness(
        "table", "tables and mappings", definitions.check_table, definitions.table_seeds, 3.0,
        (*_TOML, *b"nan inf 1e308 -1e308 true ; , FLU ENU xyzw ms".split(), b"\n%\n", b'"'), 4096,
    ),
    Harness("airframe", "airframe files", files.check_airframe, files.toml_seeds, 6.0, _TOML),
    Harness(
        "result", "results, baselines", files.check_result, files.result_seeds, 8.0, _JSON, 4096
    ),
    Harness("plan", "flight plans", files.check_plan, files.plan_seeds, 10.0, _JSON),
    Harness("truth", "truth files", files.check_truth, files.truth_seeds, 10.0, _JSON),
    Harness("key", "keys for signing", files.check_key, files.key_seeds, 8.0, (), 200),
    Harness("url", "names of links", files.check_url, files.url_seeds, 15.0, _WORDS, 100),
    Harness(
        "options", "options of the line", files.check_options, files.option_seeds, 14.0, _WORDS, 100
    ),
    Harness("wizard", "the wizard's answers", files.check_wizard, files.wizard_seeds, 1.5, _TALK),
)  # fmt: skip
