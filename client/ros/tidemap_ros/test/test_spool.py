"""The spool: numbers, restarts, torn ends, limits, and the state of the daemon."""

from __future__ import annotations

import os
import random
import subprocess
import sys

import pytest

from tidemap_ros.spool import Full, Spool, SpoolError

MEGABYTE = 1 << 20


def everything(spool: Spool) -> dict[int, bytes]:
    found, at = {}, None
    for number in range(spool.first, spool.last + 1):
        raw, at = spool.read(at, number)
        found[number] = raw
    return found


def test_records_keep_their_numbers_through_restarts(tmp_path):
    spool = Spool(tmp_path, MEGABYTE)
    assert [spool.append(bytes([value] * 10)) for value in (1, 2, 3)] == [1, 2, 3]
    spool.close()
    again = Spool(tmp_path, MEGABYTE)
    assert again.append(b"four") == 4
    assert everything(again) == {1: b"\1" * 10, 2: b"\2" * 10, 3: b"\3" * 10, 4: b"four"}
    assert again.read(None, 3)[0] == b"\3" * 10 and again.read(None, 5) is None and again.read(None, 0) is None


def test_what_is_acknowledged_goes_and_its_number_does_not_come_back(tmp_path):
    spool = Spool(tmp_path, 1600)
    spool.linked(0)
    for _ in range(50):
        number = spool.append(b"x" * 200)
        spool.acknowledged(number)
    assert number == 50 and spool.bytes < 500
    spool.close()
    again = Spool(tmp_path, 1600)
    assert again.append(b"y") == 51


def test_a_full_spool_refuses_the_newest_and_keeps_the_oldest(tmp_path):
    spool = Spool(tmp_path, 1000)
    spool.linked(0)
    for value in range(9):
        spool.append(bytes([value]) * 100)
    with pytest.raises(Full, match="972 of 1000"):
        spool.append(b"z" * 100)
    assert everything(spool)[1] == b"\0" * 100 and spool.last == 9
    assert sum(path.stat().st_size for path in tmp_path.glob("*.spool")) <= 1000
    spool.acknowledged(3)
    assert spool.append(b"z" * 100) == 10


@pytest.mark.parametrize("seed", range(5))
def test_any_cut_leaves_the_whole_records_before_it(tmp_path, seed):
    chance = random.Random(seed)
    spool = Spool(tmp_path, MEGABYTE)
    sizes = [chance.randrange(1, 60) for _ in range(20)]
    for size in sizes:
        spool.append(os.urandom(size))
    whole = everything(spool)
    spool.close()
    path = next(tmp_path.glob("*.spool"))
    cut = chance.randrange(path.stat().st_size)
    os.truncate(path, cut)
    again = Spool(tmp_path, MEGABYTE)
    kept = everything(again)
    assert kept == {number: whole[number] for number in range(1, len(kept) + 1)}
    assert sum(sizes[: len(kept)]) + 8 * len(kept) <= cut < sum(sizes[: len(kept) + 1]) + 8 * (len(kept) + 1)
    assert again.append(b"next") == len(kept) + 1


def test_a_flipped_bit_in_the_last_record_is_cut_off_and_counted(tmp_path):
    spool = Spool(tmp_path, MEGABYTE)
    for raw in (b"one", b"two"):
        spool.append(raw)
    spool.close()
    path = next(tmp_path.glob("*.spool"))
    raw = bytearray(path.read_bytes())
    raw[-1] ^= 4
    path.write_bytes(raw)
    again = Spool(tmp_path, MEGABYTE)
    assert everything(again) == {1: b"one"} and again.cut_bytes == 11


def test_a_missing_segment_is_told_and_not_passed_over(tmp_path):
    spool = Spool(tmp_path, 1600)
    for _ in range(12):
        spool.append(b"x" * 100)
    spool.close()
    sorted(tmp_path.glob("*.spool"))[1].unlink()
    with pytest.raises(SpoolError, match="damaged or missing"):
        Spool(tmp_path, 1600)


def test_two_programs_do_not_share_a_spool(tmp_path):
    spool = Spool(tmp_path, MEGABYTE)
    with pytest.raises(SpoolError, match="another program"):
        Spool(tmp_path, MEGABYTE)
    spool.close()
    Spool(tmp_path, MEGABYTE).close()


def test_a_fresh_folder_goes_on_behind_what_the_daemon_has(tmp_path):
    spool = Spool(tmp_path, MEGABYTE)
    spool.append(b"seen before the daemon was reached")
    spool.linked(500)
    assert spool.offset == 500 and spool.first == 1 and spool.lost == 0
    spool.close()
    # The record was sent as 501, and the daemon has it: it is removed.
    again = Spool(tmp_path, MEGABYTE)
    again.linked(501)
    assert again.offset == 500
    assert again.append(b"next") == 2


def test_a_restored_backup_is_told_and_what_is_left_is_sent_behind_it(tmp_path):
    spool = Spool(tmp_path, 1600)
    spool.linked(0)
    for _ in range(12):
        spool.append(b"x" * 100)
    spool.acknowledged(10)
    first = spool.first
    assert first > 4
    spool.linked(3)
    assert spool.lost == first - 1 - 3 and first + spool.offset == 4


def test_a_copy_of_an_older_folder_does_not_use_numbers_twice(tmp_path):
    spool = Spool(tmp_path, MEGABYTE)
    spool.linked(0)
    spool.append(b"one")
    spool.linked(9)
    assert spool.append(b"new") + spool.offset == 10


def test_records_that_a_power_cut_took_do_not_hide_new_ones(tmp_path):
    spool = Spool(tmp_path, MEGABYTE)
    spool.linked(0)
    for raw in (b"one", b"two", b"three"):
        spool.append(raw)
    spool.close()
    # The daemon has all three; the disk has lost the last.
    path = next(tmp_path.glob("*.spool"))
    os.truncate(path, path.stat().st_size - 1)
    again = Spool(tmp_path, MEGABYTE)
    number = again.append(b"new")
    assert number == 3
    # Ended before the daemon was reached: another start.
    again.close()
    again = Spool(tmp_path, MEGABYTE)
    again.linked(3)
    assert number + again.offset == 4 and again.read(None, number)[0] == b"new"
    # The state stays so.
    again.close()
    last = Spool(tmp_path, MEGABYTE)
    last.linked(3)
    assert (number + last.offset, last.read(None, number)[0]) == (4, b"new")


def test_a_closed_spool_changes_nothing(tmp_path):
    spool = Spool(tmp_path, MEGABYTE)
    spool.linked(0)
    spool.append(b"one")
    spool.close()
    for call in (lambda: spool.append(b"two"), lambda: spool.linked(0)):
        with pytest.raises(SpoolError, match="closed"):
            call()
    spool.acknowledged(1)
    assert spool.read(None, 1) is None
    again = Spool(tmp_path, MEGABYTE)
    assert (again.offset, everything(again)) == (0, {1: b"one"})


def test_kill_9_loses_nothing_that_was_appended(tmp_path):
    program = (
        "import sys, os; from tidemap_ros.spool import Spool\n"
        f"spool = Spool({str(tmp_path)!r}, 1 << 20)\n"
        "for value in range(100): print(spool.append(b'%d' % value), flush=True)\n"
        "os.kill(os.getpid(), 9)"
    )
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False).stdout
    assert out.split()[-1] == "100"
    assert everything(Spool(tmp_path, MEGABYTE)) == {value + 1: b"%d" % value for value in range(100)}
