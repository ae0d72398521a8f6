"""A blackbox session read byte by byte, as the reference decoder does it: slow and plain.

It differs from that where the reader says so: a pause needs an I frame behind it, P frames count
for so long after an I frame, two I frames that agree with each other are believed, and a number
of too many bytes has all of them.
"""

from dataclasses import dataclass, field

from gcs_sysid.telemetry.blackbox_format import Definition, Header

_WRAP = 2**32
_FIXED_EVENTS = {10: 5, 11: 4, 12: 8, 41: 5}
_VB_EVENTS = {0: 1, 14: 2, 15: 1, 30: 2, 40: 1}


class _EndError(Exception):
    pass


class _Stream:
    def __init__(self, data: bytes, at: int, stop: int) -> None:
        self.data, self.at, self.stop = data, at, stop

    def byte(self) -> int:
        if self.at >= self.stop:
            raise _EndError
        self.at += 1
        return self.data[self.at - 1]

    def unsigned(self) -> int:
        value, count = 0, 0
        while (byte := self.byte()) > 127:
            value |= (byte & 127) << 7 * count
            count += 1
        return (value | byte << 7 * count) % _WRAP if count < 5 else 0

    def signed(self) -> int:
        value = self.unsigned()
        return value >> 1 ^ -(value & 1)


def _extend(value: int, bits: int) -> int:
    value %= 1 << bits
    return value - (1 << bits) if value >> bits - 1 else value


def _tag2(stream: _Stream, variable: bool) -> list[int]:
    lead = stream.byte()
    kind = lead >> 6
    if kind == 0:
        return [_extend(lead >> shift, 2) for shift in (4, 2, 0)]
    if kind == 3:
        values = []
        for i in range(3):
            size = (lead >> 2 * i & 3) + 1
            raw = bytes(stream.byte() for _ in range(size))
            values.append(_extend(int.from_bytes(raw, "little"), 8 * size))
        return values
    second = stream.byte()
    if kind == 1:
        if variable:
            word = lead << 8 | second
            return [_extend(word >> 9, 5), _extend(word >> 4, 5), _extend(word, 4)]
        return [_extend(lead, 4), _extend(second >> 4, 4), _extend(second, 4)]
    third = stream.byte()
    if variable:
        word = lead << 16 | second << 8 | third
        return [_extend(word >> 14, 8), _extend(word >> 7, 7), _extend(word, 7)]
    return [_extend(byte, 6) for byte in (lead, second, third)]


def _tag8_4(stream: _Stream) -> list[int]:
    tag, values = stream.byte(), []
    nibble: int | None = None

    def take() -> int:
        nonlocal nibble
        if nibble is None:
            byte = stream.byte()
            nibble = byte & 15
            return byte >> 4
        low, nibble = nibble, None
        return low

    for i in range(4):
        digits = (0, 1, 2, 4)[tag >> 2 * i & 3]
        value = 0
        for _ in range(digits):
            value = value << 4 | take()
        values.append(_extend(value, 4 * digits) if digits else 0)
    return values


def _old_tag8_4(stream: _Stream) -> list[int]:
    tag = stream.byte()
    values: list[int] = []
    while len(values) < 4:
        kind = tag >> 2 * len(values) & 3
        if kind == 1:
            byte = stream.byte()
            values += [_extend(byte, 4), _extend(byte >> 4, 4)]
        elif kind == 0:
            values.append(0)
        else:
            raw = bytes(stream.byte() for _ in range(kind - 1))
            values.append(_extend(int.from_bytes(raw, "little"), 8 * len(raw)))
    return values[:4]


@dataclass
class Plain:
    """What was read: main frames with their times, and the others."""

    main: list[list[int]] = field(default_factory=list)
    time_us: list[int] = field(default_factory=list)
    slow: list[list[int]] = field(default_factory=list)
    damaged: int = 0


@dataclass
class _Chain:
    """An I frame and the P frames that build on it."""

    rows: list[list[int]]
    passed: list[int]
    start: int | None = None
    whole: bool = True


class PlainReader:
    """Reads one session."""

    def __init__(self, data: bytes, header: Header, stop: int) -> None:
        self._data, self._header, self._stop = data, header, stop
        names = header.frames["I"].names
        self._loop, self._clock = names.index("loopIteration"), names.index("time")
        self._motor = names.index("motor[0]") if "motor[0]" in names else 0
        self._parts: list[_Chain | tuple[int, int]] = []
        self._out = Plain()

    def read(self) -> Plain:
        """All of it."""
        order: list[tuple[_Chain, int]] = []
        chain: _Chain | None = None
        at, stop = self._header.data, self._stop
        while at < stop:
            letter = chr(self._data[at])
            if letter not in (*self._header.frames, "E"):
                chain, at = None, at + 1
                continue
            stream, over = _Stream(self._data, at + 1, stop), False
            try:
                if letter == "E":
                    longest = 256
                    event, over = self._event(stream)
                else:
                    definition = self._header.frames[letter]
                    longest = max(256, 4 * len(definition.names))
                    raw = self._raw(definition, stream)
                whole = stream.at - at - 1 <= longest and (
                    over or stream.at == stop or chr(self._data[stream.at]) in "IPGHSE"
                )
            except _EndError:
                whole = False
            if not whole:
                self._out.damaged += 1
                chain, at = None, at + 1
                continue
            at = stream.at
            if letter == "I":
                chain = _Chain([self._fixed("I", raw)], [0])
                self._parts.append(chain)
                order.append((chain, 0))
            elif letter == "P" and chain is not None and self._add(chain, raw):
                order.append((chain, len(chain.rows) - 1))
            elif letter == "S":
                self._out.slow.append(self._fixed("S", raw))
            elif letter == "E" and event is not None:
                self._parts.append(event)
                chain = None
            if over:
                break
        self._believe()
        for chain, row in order:
            if chain.start is not None:
                self._out.main.append(chain.rows[row])
                self._out.time_us.append(chain.start + chain.passed[row])
        return self._out

    def _event(self, stream: _Stream) -> tuple[tuple[int, int] | None, bool]:
        """What a pause says, and whether the log ends."""
        kind = stream.byte()
        if kind == 255:
            return None, bytes(stream.byte() for _ in range(11)) == b"End of log\0"
        if kind == 13:
            if stream.byte() > 127:
                stream.at += 4
            else:
                stream.unsigned()
        elif kind == 20:
            stream.byte()
            stream.unsigned()
            stream.at += 2
        else:
            stream.at += _FIXED_EVENTS.get(kind, 0)
        numbers = [stream.unsigned() for _ in range(_VB_EVENTS.get(kind, 0))]
        if stream.at > stream.stop:
            raise _EndError
        return ((numbers[0], numbers[1]) if kind == 14 else None), False

    def _raw(self, definition: Definition, stream: _Stream) -> list[int]:
        count, values = len(definition.names), []
        while len(values) < count:
            i = len(values)
            encoding = definition.encodings[i]
            if definition.predictors[i] == 6 or encoding == 9:
                values.append(0)
            elif encoding in (0, 1):
                values.append(stream.signed() if encoding == 0 else stream.unsigned())
            elif encoding == 3:
                low = stream.unsigned() % 2**16
                values.append(-_extend(low, 14) if low & 0x2000 else -low)
            elif encoding == 6:
                run = i + 1
                while run < min(i + 8, count) and self._is_8(definition, run):
                    run += 1
                tag = stream.byte() if run - i > 1 else 1
                values += [stream.signed() if tag >> j & 1 else 0 for j in range(run - i)]
            elif encoding == 8:
                old = self._header.version < 2
                values += _old_tag8_4(stream) if old else _tag8_4(stream)
            else:
                values += _tag2(stream, encoding == 10)
        return values[:count]

    def _is_8(self, definition: Definition, i: int) -> bool:
        return definition.encodings[i] == 6 and definition.predictors[i] != 6

    def _cut(self, letter: str, i: int, value: int) -> int:
        definition = self._header.frames[letter]
        if definition.predictors[i] == 6 or definition.encodings[i] not in (0, 1, 3, 9):
            return value
        return _extend(value, 32) if definition.signed[i] else value % _WRAP

    def _fixed(self, letter: str, raw: list[int]) -> list[int]:
        """Values of a frame that builds on no other."""
        definition, constants = self._header.frames[letter], self._header.constants()
        values = list(raw)
        for i, predictor in enumerate(definition.predictors):
            values[i] += constants.get(predictor, 0)
            values[i] = self._cut(letter, i, values[i])
        return [self._cut(letter, i, v) for i, v in enumerate(self._with_motor(letter, values))]

    def _with_motor(self, letter: str, values: list[int]) -> list[int]:
        kinds = self._header.frames[letter].predictors
        pairs = zip(values, kinds, strict=True)
        return [v + values[self._motor] if kind == 5 else v for v, kind in pairs]

    def _add(self, chain: _Chain, raw: list[int]) -> bool:
        """Add a P frame to a chain, if it can be."""
        if not chain.whole or len(chain.rows) > 4096:
            chain.whole = False
            return False
        constants = self._header.constants()
        one, two = chain.rows[-1], chain.rows[max(len(chain.rows) - 2, 0)]
        step = 1
        while (one[self._loop] + step) % self._header.interval not in self._header.logged:
            step += 1
        values = list(raw)
        for i, predictor in enumerate(self._header.frames["P"].predictors):
            if predictor == 1:
                values[i] += one[i]
            elif predictor == 2:
                values[i] += 2 * one[i] - two[i]
            elif predictor == 3:
                total = one[i] + two[i]
                values[i] += -(-total // 2) if total < 0 else total // 2
            elif predictor == 6:
                values[i] = one[i] + step
            values[i] += constants.get(predictor, 0)
            values[i] = self._cut("P", i, values[i])
        values = [self._cut("P", i, v) for i, v in enumerate(self._with_motor("P", values))]
        jump = values[self._loop] % _WRAP - one[self._loop] % _WRAP
        forward = (values[self._clock] - one[self._clock]) % _WRAP
        if not 0 <= jump < 5000 or forward >= 10_000_000:
            chain.whole = False
            return False
        chain.rows.append(values)
        chain.passed.append(chain.passed[-1] + forward)
        return True

    def _believe(self) -> None:
        """Decide which chains are believed, and when they begin."""
        last: tuple[int, int] | None = None
        doubted: _Chain | None = None
        now = 0

        def ends(chain: _Chain, row: int) -> tuple[int, int]:
            values = chain.rows[row]
            return values[self._loop] % _WRAP, values[self._clock] % _WRAP

        def follows(before: tuple[int, int], after: tuple[int, int]) -> bool:
            return 0 <= after[0] - before[0] < 5000 and (after[1] - before[1]) % _WRAP < 10_000_000

        for part in self._parts:
            if isinstance(part, tuple):
                now += (part[1] - last[1]) % _WRAP if last else part[1]
                last, doubted = part, None
                continue
            first = ends(part, 0)
            if last is None:
                part.start = first[1]
            elif follows(last, first):
                part.start = now + (first[1] - last[1]) % _WRAP
            elif doubted is not None and follows(ends(doubted, -1), first):
                before = (first[1] - ends(doubted, 0)[1]) % _WRAP
                part.start = now + _extend(first[1] - last[1], 32)
                part.start += _WRAP if part.start < before else 0
                doubted.start = max(part.start - before, 0)
            else:
                doubted = part
                continue
            now, doubted = part.start + part.passed[-1], None
            last = ends(part, -1)
