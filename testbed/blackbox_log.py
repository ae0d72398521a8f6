"""Blackbox logs of our own making: every encoding and predictor, as the firmware writes them."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

MAGIC = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n"
SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NULL, TAG2_3SVARIABLE = (
    0, 1, 3, 6, 7, 8, 9, 10,
)  # fmt: skip
(
    ZERO, PREVIOUS, STRAIGHT_LINE, AVERAGE_2, MINTHROTTLE, MOTOR_0, INCREMENT, HOME_COORD,
    FIXED_1500, VBATREF, LAST_MAIN_FRAME_TIME, MINMOTOR,
) = range(12)  # fmt: skip
_WRAP = 2**32


class Field(NamedTuple):
    """A field of main frames; of other frames the last two are not used."""

    name: str
    signed: int = 1
    predictor: int = ZERO
    encoding: int = SIGNED_VB
    p_predictor: int = PREVIOUS
    p_encoding: int = SIGNED_VB


CLOCK = (
    Field("loopIteration", 0, ZERO, UNSIGNED_VB, INCREMENT, NULL),
    Field("time", 0, ZERO, UNSIGNED_VB, STRAIGHT_LINE, SIGNED_VB),
)
SLOW = (
    Field("flightModeFlags", 0, ZERO, UNSIGNED_VB),
    Field("stateFlags", 0, ZERO, UNSIGNED_VB),
    Field("failsafePhase", 0, ZERO, TAG2_3S32),
    Field("rxSignalReceived", 0, ZERO, TAG2_3S32),
    Field("rxFlightChannelsValid", 0, ZERO, TAG2_3S32),
)
HOME = (Field("GPS_home[0]"), Field("GPS_home[1]"))
GPS = (
    Field("time", 0, LAST_MAIN_FRAME_TIME, UNSIGNED_VB),
    Field("GPS_numSat", 0, ZERO, UNSIGNED_VB),
    Field("GPS_coord[0]", 1, HOME_COORD),
    Field("GPS_coord[1]", 1, HOME_COORD),
)
END = b"E\xffEnd of log\0"


def unsigned_vb(value: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    value %= _WRAP
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


def signed_vb(value: int) -> bytes:
    """The same, with the sign as the lowest bit."""
    value = (value + _WRAP // 2) % _WRAP - _WRAP // 2
    return unsigned_vb(value << 1 ^ value >> 31)


def tag8_8svb(values: Sequence[int]) -> bytes:
    """A bit for each value that is not zero, and those."""
    if len(values) == 1:
        return signed_vb(values[0])
    tag = sum(1 << i for i, value in enumerate(values) if value)
    return bytes([tag]) + b"".join(signed_vb(value) for value in values if value)


def _fits(values: Sequence[int], bits: Sequence[int]) -> bool:
    pairs = zip(values, bits, strict=True)
    return all(-(1 << n - 1) <= value < 1 << n - 1 for value, n in pairs)


def tag2_3(values: Sequence[int], *, variable: bool) -> bytes:
    """Two bits for the widths, and three values."""
    a, b, c = values
    if _fits(values, (2, 2, 2)):
        return bytes([(a & 3) << 4 | (b & 3) << 2 | c & 3])
    if variable:
        if _fits(values, (5, 5, 4)):
            return ((1 << 14) | (a & 31) << 9 | (b & 31) << 4 | c & 15).to_bytes(2, "big")
        if _fits(values, (8, 7, 7)):
            word = (2 << 22) | (a & 255) << 14 | (b & 127) << 7 | c & 127
            return word.to_bytes(3, "big")
    else:
        if _fits(values, (4, 4, 4)):
            return bytes([1 << 6 | a & 15, (b & 15) << 4 | c & 15])
        if _fits(values, (6, 6, 6)):
            return bytes([2 << 6 | a & 63, b & 63, c & 63])
    tag, out = 3 << 6, b""
    for i, value in enumerate(values):
        size = next(n for n in (1, 2, 3, 4) if _fits([value], [8 * n]) or n == 4)
        tag |= size - 1 << 2 * i
        out += (value % (1 << 8 * size)).to_bytes(size, "little")
    return bytes([tag]) + out


def tag8_4s16(values: Sequence[int], version: int) -> bytes:
    """Two bits of width for each of four values: none, 4, 8 or 16 bits."""
    if version < 2:
        return _old_tag8_4s16(values)
    tag, nibbles = 0, ""
    for i, value in enumerate(values):
        kind = 0 if value == 0 else 1 if _fits([value], [4]) else 2 if _fits([value], [8]) else 3
        tag |= kind << 2 * i
        digits = (0, 1, 2, 4)[kind]
        nibbles += f"{value % 16**digits:0{digits}x}" if digits else ""
    return bytes([tag]) + bytes.fromhex(nibbles + "0" * (len(nibbles) % 2))


def _old_tag8_4s16(values: Sequence[int]) -> bytes:
    tag, out, i = 0, b"", 0
    while i < 4:
        value = values[i]
        if i < 3 and _fits(values[i : i + 2], (4, 4)) and any(values[i : i + 2]):
            tag |= 5 << 2 * i
            out += bytes([value & 15 | (values[i + 1] & 15) << 4])
            i += 2
            continue
        kind = 0 if value == 0 else 2 if _fits([value], [8]) else 3
        tag |= kind << 2 * i
        size = (0, 0, 1, 2)[kind]
        out += (value % (1 << 8 * size)).to_bytes(size, "little")
        i += 1
    return bytes([tag]) + out


@dataclass
class BlackboxWriter:
    """Writes one session as the firmware does.

    Attributes:
        main: fields of I and P frames.
        others: letter -> fields of S, G and H frames.
        settings: further lines of the header.
        interval: loops between I frames.
        every: every so many loops are logged.
        version: of the data.
    """

    main: Sequence[Field]
    others: Mapping[str, Sequence[Field]]
    settings: Mapping[str, object]
    interval: int = 32
    every: int = 1
    version: int = 2

    def __post_init__(self) -> None:
        self.data = self.header()
        self._before: list[list[int]] = []
        self._home = [0, 0]

    def header(self) -> bytes:
        """The lines of text."""
        lines = [f"Data version:{self.version}", f"I interval:{self.interval}"]
        lines.append(f"P interval:1/{self.every}")
        lines += [f"{name}:{value}" for name, value in self.settings.items()]
        for letter, fields in (("I", self.main), *self.others.items()):
            columns = {"name": 0, "signed": 1, "predictor": 2, "encoding": 3}
            for what, i in columns.items():
                lines.append(f"Field {letter} {what}:{','.join(str(f[i]) for f in fields)}")
        for what, i in {"predictor": 4, "encoding": 5}.items():
            lines.append(f"Field P {what}:{','.join(str(f[i]) for f in self.main)}")
        return MAGIC + b"".join(f"H {line}\n".encode() for line in lines)

    def intra(self, values: Sequence[int]) -> bytes:
        """An I frame."""
        self._before = []
        frame = b"I" + self._frame(self.main, values, 2)
        self._before = [list(values)] * 2
        return self._add(frame)

    def inter(self, values: Sequence[int]) -> bytes:
        """A P frame; `INCREMENT` fields must have the values that a reader will give them."""
        frame = b"P" + self._frame(self.main, values, 4)
        self._before = [list(values), self._before[0]]
        return self._add(frame)

    def other(self, letter: str, values: Sequence[int]) -> bytes:
        """A S, G or H frame."""
        frame = letter.encode() + self._frame(self.others[letter], values, 2)
        if letter == "H":
            self._home = list(values)
        return self._add(frame)

    def event(self, kind: int, content: bytes = b"") -> bytes:
        """An event."""
        return self._add(b"E" + bytes([kind]) + content)

    def resume(self, loop: int, time: int) -> bytes:
        """The event after a pause."""
        return self.event(14, unsigned_vb(loop) + unsigned_vb(time))

    def _add(self, frame: bytes) -> bytes:
        self.data += frame
        return frame

    def _predicted(self, fields: Sequence[Field], i: int, kind: int, values: Sequence[int]) -> int:
        if self._before:
            one, two = self._before[0], self._before[1]
        low = int(str(self.settings.get("minthrottle", 1150)))
        if kind == PREVIOUS:
            return one[i]
        if kind == STRAIGHT_LINE:
            return 2 * one[i] - two[i]
        if kind == AVERAGE_2:
            total = one[i] + two[i]
            return -(-total // 2) if total < 0 else total // 2
        if kind == MOTOR_0:
            return values[[field.name for field in fields].index("motor[0]")]
        if kind == HOME_COORD:
            return self._home[i > 0 and fields[i - 1].predictor == HOME_COORD]
        if kind == LAST_MAIN_FRAME_TIME:
            return self._before[0][1] if self._before else 0
        motor = str(self.settings.get("motorOutput", low)).split(",")[0]
        vbat = int(str(self.settings.get("vbatref", 4095)))
        return {MINTHROTTLE: low, FIXED_1500: 1500, VBATREF: vbat, MINMOTOR: int(motor)}.get(
            kind, 0
        )

    def _frame(self, fields: Sequence[Field], values: Sequence[int], at: int) -> bytes:
        kinds, encodings = [f[at] for f in fields], [f[at + 1] for f in fields]
        left = [
            value - self._predicted(fields, i, kind, values)
            for i, (value, kind) in enumerate(zip(values, kinds, strict=True))
        ]
        out, i = b"", 0
        while i < len(fields):
            encoding, count = encodings[i], 1
            if kinds[i] == INCREMENT:
                pass
            elif encoding == SIGNED_VB:
                out += signed_vb(left[i])
            elif encoding == UNSIGNED_VB:
                out += unsigned_vb(left[i])
            elif encoding == NEG_14BIT:
                out += unsigned_vb(-left[i] & 0x3FFF)
            elif encoding == TAG8_8SVB:
                run = i
                while run < min(i + 8, len(fields)) and encodings[run] == encoding:
                    run += 1
                count = run - i
                out += tag8_8svb(left[i:run])
            elif encoding == TAG8_4S16:
                count = 4
                out += tag8_4s16((left[i : i + 4] + [0] * 3)[:4], self.version)
            elif encoding in (TAG2_3S32, TAG2_3SVARIABLE):
                count = 3
                three = (left[i : i + 3] + [0] * 2)[:3]
                out += tag2_3(three, variable=encoding == TAG2_3SVARIABLE)
            i += count
        return out


def float_bits(value: float) -> str:
    """A float as the header has `gyro_scale`."""
    return f"0x{struct.unpack('>I', struct.pack('>f', value))[0]:x}"
