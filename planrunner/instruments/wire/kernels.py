"""Contains compiled operations on every byte of a stream: computing checksums, searching for frames, converting fields to columns.

The functions of `checksums`, `framing` and `columns` that call these kernels document the shapes and meanings of the arguments.
This module imports numba, so it is imported only when there are bytes to process.

numba compiles a function once for each combination of argument types. In a call, a literal number has a different type
(`Literal[int](0)`) from a variable. Such numbers are therefore written as `np.int64(0)`, so that every function is compiled only
once.
"""

from __future__ import annotations

import numpy as np

from planrunner.base.compiled import compiled
from planrunner.instruments.wire.codes import (
    CRC,
    FIXED,
    FLOAT,
    FRACTION_FIRST,
    LINE,
    NEGATIVE_SUM,
    NONE,
    SIGNED,
    UNSIGNED,
    XBUS,
    XOR,
)

LINE_FEED, CARRIAGE_RETURN, ASTERISK, COMMA = 10, 13, 42, 44
BIG = np.int64(0)  # byte order, as `little` of the functions below
POWERS = np.array([10.0**power for power in range(16)])


@compiled()
def _mirrored(number, bits):  # type: ignore[no-untyped-def]
    found = np.uint32(0)
    for _ in range(bits):
        found = np.uint32((found << 1) | (number & 1))
        number = np.uint32(number >> 1)
    return found


@compiled()
def _word(data, place, little):  # type: ignore[no-untyped-def]
    """Returns four bytes, combined into one number. `place`: index of the first byte. The type of `place` must be unsigned, so that
    numba need not check for a negative index."""
    first, second = np.uint32(data[place]), np.uint32(data[place + np.uintp(1)])
    third, fourth = np.uint32(data[place + np.uintp(2)]), np.uint32(data[place + np.uintp(3)])
    if little:
        return np.uint32(first | (second << 8) | (third << 16) | (fourth << 24))
    return np.uint32((first << 24) | (second << 16) | (third << 8) | fourth)


@compiled()
def value(data, start, length, padding, kind, width, tables, initial, reflected, final):  # type: ignore[no-untyped-def]
    """Computes the check value of data[start : start + length] followed by `padding` zeros. As numba widens integers, registers are
    reduced to 32 bits. Indices are unsigned, so that numba does not check for negative values."""
    if kind == XOR:
        together = np.int64(0)
        for item in range(length):
            together ^= np.int64(data[np.uintp(start + item)])
        return np.uint32(together)
    if kind != CRC:
        total = np.int64(0)
        for item in range(length):
            total += np.int64(data[np.uintp(start + item)])
        return np.uint32((-total if kind == NEGATIVE_SUM else total) & ((np.int64(1) << width) - 1))
    register = np.uint32(initial << (32 - width))
    place, end = np.uintp(start), np.uintp(start + length)
    if not reflected:
        while place + np.uintp(8) <= end:
            register = np.uint32(register ^ _word(data, place, BIG))
            register = np.uint32(
                tables[7, np.uintp(register >> 24)]
                ^ tables[6, np.uintp((register >> 16) & 0xFF)]
                ^ tables[5, np.uintp((register >> 8) & 0xFF)]
                ^ tables[4, np.uintp(register & 0xFF)]
                ^ tables[3, data[place + np.uintp(4)]]
                ^ tables[2, data[place + np.uintp(5)]]
                ^ tables[1, data[place + np.uintp(6)]]
                ^ tables[0, data[place + np.uintp(7)]]
            )
            place += np.uintp(8)
        if place + np.uintp(4) <= end:
            register = np.uint32(register ^ _word(data, place, BIG))
            register = np.uint32(
                tables[3, np.uintp(register >> 24)]
                ^ tables[2, np.uintp((register >> 16) & 0xFF)]
                ^ tables[1, np.uintp((register >> 8) & 0xFF)]
                ^ tables[0, np.uintp(register & 0xFF)]
            )
            place += np.uintp(4)
    stop = end + np.uintp(padding)
    while place < stop:
        byte = np.uint32(data[place]) if place < end else np.uint32(0)
        if reflected:
            byte = _mirrored(byte, np.int64(8))
        register = np.uint32(np.uint32(register << 8) ^ tables[0, np.uintp((register >> 24) ^ byte)])
        place += np.uintp(1)
    register = np.uint32(register >> (32 - width))
    if reflected:
        register = _mirrored(register, width)
    return np.uint32(register ^ np.uint32(final))


@compiled()
def values(data, starts, length, padding, kind, width, tables, initial, reflected, final):  # type: ignore[no-untyped-def]
    found = np.empty(starts.size, np.uint32)
    for item in range(starts.size):
        found[item] = value(data, starts[item], length, padding, kind, width, tables, initial, reflected, final)
    return found


@compiled()
def _matches(data, place, pattern):  # type: ignore[no-untyped-def]
    """Returns 1 if the pattern is at this place, 0 if it is not, and −1 if the data end within the pattern."""
    for item in range(pattern.size):
        if place + item >= data.size:
            return -1
        if data[place + item] != pattern[item]:
            return 0
    return 1


@compiled()
def _length(data, place, rule, longest):  # type: ignore[no-untyped-def]
    """Returns the length in bytes of the frame that begins at `place`; 0 if there is no frame, −1 if the data end before the length
    is known."""
    if rule == FIXED:
        return longest
    if rule == XBUS:
        if place + 4 > data.size:
            return -1
        length = 5 + np.int64(data[place + 3])
        if data[place + 3] == 255:
            if place + 6 > data.size:
                return -1
            length = 7 + np.int64(data[place + 4]) * 256 + np.int64(data[place + 5])
        return length if length <= longest else 0
    return _line(data, place, longest, np.int64(0))[0]


@compiled()
def _digit(byte):  # type: ignore[no-untyped-def]
    if 48 <= byte <= 57:
        return byte - 48
    if 65 <= byte <= 70:
        return byte - 55
    return byte - 87 if 97 <= byte <= 102 else 256


@compiled()
def _line(data, place, longest, usual):  # type: ignore[no-untyped-def]
    """Returns the length in bytes of the line that begins at `place`, as in `_length`, and the exclusive-or of all its bytes except
    the first. `usual`: length of the previous line; 0 if unknown.

    Lines usually have the same length as the previous line. First, a loop with a known end checks whether the lengths are equal,
    because such a loop can process many bytes at once. Otherwise, the end of the line is searched for, four bytes at a time, and
    the same loop is executed again.
    """
    start, stop = np.uintp(place + 1), np.uintp(min(place + longest, data.size))
    end, feed = start, np.uint8(LINE_FEED)
    if usual > 1 and place + usual <= data.size and usual <= longest and data[np.uintp(place + usual - 1)] == feed:
        end = np.uintp(place + usual - 1)
        together, strange, earlier = _summary(data, start, end)
        if not earlier:
            return (0, np.uint32(0)) if strange else (np.int64(usual), np.uint32(together ^ feed))
        end = start
    one, two, three, four = np.uintp(1), np.uintp(2), np.uintp(3), np.uintp(4)
    while end + four <= stop and not (
        (data[end] == feed) | (data[end + one] == feed) | (data[end + two] == feed) | (data[end + three] == feed)
    ):
        end += four
    while end < stop and data[end] != feed:
        end += one
    together, strange, _ = _summary(data, start, end)
    if strange:
        return 0, np.uint32(0)
    if end < stop:
        return np.int64(end) + 1 - place, np.uint32(together ^ feed)
    return (0 if data.size - place >= longest else -1), np.uint32(0)


@compiled()
def _summary(data, start, end):  # type: ignore[no-untyped-def]
    """Returns three values for data[start:end]: the exclusive-or of the bytes; whether a byte is above 126; and whether a byte is a
    line feed."""
    together, strange, feeds, feed = np.uint8(0), np.uint8(0), np.uint8(0), np.uint8(LINE_FEED)
    for item in range(start, end):
        byte = data[np.uintp(item)]
        together = np.uint8(together ^ byte)
        strange = np.uint8(strange | np.uint8(byte > 126))
        feeds = np.uint8(feeds | np.uint8(byte == feed))
    return together, strange, feeds


@compiled()
def _line_holds(data, place, length, together, kind, width, tables, initial, reflected, final):  # type: ignore[no-untyped-def]
    """Returns True if the checksum of a line is correct. `together`: exclusive-or of all bytes of the line except the first."""
    end = place + length - 1
    if data[end - 1] == CARRIAGE_RETURN:
        end -= 1
    if length < 6 or end - 3 <= place or data[end - 3] != ASTERISK:
        return False
    told = np.int64(_digit(data[end - 2])) * 16 + np.int64(_digit(data[end - 1]))
    if kind == XOR:
        for item in range(end - 3, place + length):
            together ^= np.uint32(data[np.uintp(item)])
        return told == np.int64(together)
    found = value(data, place + 1, end - 4 - place, np.int64(0), kind, width, tables, initial, reflected, final)
    return told == np.int64(found)


@compiled()
def _holds(data, place, length, check, kind, width, tables, initial, reflected, final):  # type: ignore[no-untyped-def]
    covered_from, padding, size, little = check
    if kind == NONE:
        return True
    covered = length - size - covered_from
    if covered < 0:
        return False
    found = np.int64(
        value(data, place + covered_from, covered, padding, kind, width, tables, initial, reflected, final)
    )
    for item in range(size):
        shift = 8 * item if little else 8 * (size - 1 - item)
        if np.int64(data[place + length - size + item]) != (found >> shift) & 0xFF:
            return False
    return True


@compiled()
def find(data, sync, trailer, shape, check, positions, base, kind, width, tables, initial, reflected, final):  # type: ignore[no-untyped-def]
    """Finds frames. Returns the starts and lengths of the valid frames, the start of the remaining bytes, the place in these bytes
    at which the next frame is expected (-1: unknown), the number of corrupt frames, and the number of skipped bytes. `positions`,
    `base`: table and constant for a CRC over frames of equal length (`Checksum.by_position`); otherwise an array of the shape (0,
    256), and 0."""
    rule, longest, expected = shape
    covered_from, _, size, little = check
    covered = positions.shape[0]
    shortest = longest if rule == FIXED else 5
    starts = np.empty(data.size // shortest + 1, np.int64)
    lengths = np.empty(starts.size, np.int64)
    count = place = corrupt = skipped = usual = np.int64(0)
    while place < data.size:
        if place == expected and trailer.size > 0:
            ends = _matches(data, place, trailer)
            if ends == -1:
                break
            if ends == 1:
                place += trailer.size
                expected = place
                continue
        begins = _matches(data, place, sync)
        length, together = np.int64(0), np.uint32(0)
        if begins == 1 and rule == LINE:
            length, together = _line(data, place, longest, usual)
        elif begins == 1:
            length = _length(data, place, rule, longest)
        if begins == -1 or length == -1 or place + length > data.size:
            break
        if length > 0:
            if rule == LINE:
                good = _line_holds(data, place, length, together, kind, width, tables, initial, reflected, final)
            elif covered > 0:  # here and not in a function: handing arrays over takes longer than the check of a frame
                crc, first = np.uint32(base), np.uintp(place + covered_from)
                for item in range(covered):
                    crc ^= positions[np.uintp(item), data[first + np.uintp(item)]]
                stored, last = np.uint32(0), np.uintp(place + length - 1 if little else place + length - size)
                for item in range(size):
                    behind = np.uintp(item)
                    stored = np.uint32((stored << 8) | data[last - behind if little else last + behind])
                good = stored == crc
            else:
                good = _holds(data, place, length, check, kind, width, tables, initial, reflected, final)
            if good:
                starts[count], lengths[count] = place, length
                count += 1
                place += length
                expected, usual = place, length
                continue
        if place == expected:
            corrupt += 1 if rule == FIXED or begins == 1 else 0  # between frames of varying length others may stand
            expected = place + length if begins == 1 else place + longest if rule == FIXED else -1
        skipped += 1
        place += 1
    expected = expected - place if expected >= place else -1
    return starts[:count], lengths[:count], place, expected, corrupt, skipped


@compiled()
def alike(data, starts, places):  # type: ignore[no-untyped-def]
    """Returns True for each frame whose bytes at `places` are equal to the bytes of the first frame at these places."""
    found = np.ones(starts.size, np.bool_)
    for frame in range(starts.size):
        for item in range(places.size):
            if data[np.uintp(starts[frame] + places[item])] != data[np.uintp(starts[0] + places[item])]:
                found[frame] = False
                break
    return found


# With an unsigned index, numba need not check whether the index counts from the end. This is twice as fast.
@compiled()
def _bits(data, place, width, little):  # type: ignore[no-untyped-def]
    step = -1 if little else 1
    first = place + width - 1 if little else place
    found = np.int64(0)
    for item in range(width):
        found = (found << 8) | np.int64(data[np.uintp(first + item * step)])
    return found


@compiled()
def bits(data, starts, offset, width, signed, little):  # type: ignore[no-untyped-def]
    out = np.empty(starts.size, np.int64)
    unused, order = 64 - 8 * width if signed else 0, np.int64(little)
    for frame in range(starts.size):
        out[frame] = (_bits(data, starts[frame] + offset, width, order) << unused) >> unused
    return out


@compiled()
def scaled(data, starts, places, scales):  # type: ignore[no-untyped-def]
    out = np.empty((places.shape[0], starts.size))
    for row in range(places.shape[0]):
        offset, width, kind, little = places[row]
        scale = scales[row]
        if kind == FLOAT:
            _floats(data, starts, offset, width, little, scale, out[row])
        elif kind == FRACTION_FIRST:
            for frame in range(starts.size):
                fraction = _bits(data, starts[frame] + offset, np.int64(4), BIG)
                whole = (_bits(data, starts[frame] + offset + 4, np.int64(2), BIG) << 48) >> 48
                out[row, frame] = (whole + fraction * 2.0**-32) * scale
        else:
            unused = 64 - 8 * width if kind == SIGNED else 0
            for frame in range(starts.size):
                found = (_bits(data, starts[frame] + offset, width, little) << unused) >> unused
                number = np.float64(found)
                if found < 0 and kind == UNSIGNED:
                    number += 2.0**64
                out[row, frame] = number * scale
    return out


@compiled()
def _floats(data, starts, offset, width, little, scale, out):  # type: ignore[no-untyped-def]
    """Converts fields of the kind FLOAT. The bits are collected first and converted to numbers afterwards, because each of these
    two loops is simple enough to process several frames at a time."""
    if width == 4:
        words = np.empty(starts.size, np.uint32)
        for frame in range(starts.size):
            words[frame] = _word(data, np.uintp(starts[frame] + offset), little)
        singles = words.view(np.float32)
        for frame in range(starts.size):
            out[frame] = singles[frame] * scale
        return
    long_words = np.empty(starts.size, np.int64)
    for frame in range(starts.size):
        long_words[frame] = _bits(data, starts[frame] + offset, width, little)
    doubles = long_words.view(np.float64)
    for frame in range(starts.size):
        out[frame] = doubles[frame] * scale


@compiled()
def decimals(data, starts, lengths, out):  # type: ignore[no-untyped-def]
    """Reads the decimal numbers that follow the commas of each line, up to `*`. Also returns True for each line in which the count
    of numbers is equal to the number of rows of `out`. A number may have at most 15 digits: it is computed as a whole number
    divided by a power of ten, so it is rounded only once.

    Each line must end with a line feed, as in the result of `find`. A line feed is not a comma, asterisk, sign, point or digit, so
    every search ends there.
    """
    good = np.zeros(starts.size, np.bool_)
    rows, one, zero, ten = out.shape[0], np.uintp(1), np.uint8(48), np.uint8(10)
    for line in range(starts.size):
        place, last = np.uintp(starts[line]), np.uintp(starts[line] + lengths[line] - 1)
        if data[last] != LINE_FEED:
            continue
        byte = data[place]
        while byte != COMMA and byte != ASTERISK and place < last:
            place += one
            byte = data[place]
        row = 0
        while row < rows and byte == COMMA:
            place += one
            byte = data[place]
            negative = byte == 45
            if negative or byte == 43:
                place += one
                byte = data[place]
            mantissa, first = np.int64(0), place
            digit = np.uint8(byte - zero)
            while digit < ten:
                mantissa = mantissa * 10 + np.int64(digit)
                place += one
                digit = np.uint8(data[place] - zero)
            digits, behind = place - first, np.uintp(0)
            if data[place] == 46:
                place += one
                first = place
                digit = np.uint8(data[place] - zero)
                while digit < ten:
                    mantissa = mantissa * 10 + np.int64(digit)
                    place += one
                    digit = np.uint8(data[place] - zero)
                behind = place - first
                digits += behind
            if digits == 0 or digits > 15:
                break
            number = mantissa / POWERS[behind]
            out[row, line] = -number if negative else number
            row += 1
            byte = data[place]
        good[line] = row == rows and byte == ASTERISK
    return good
