"""Observations that are not yet on the daemon's disk, in files of this robot.

A folder has segments, ``<number of the first record>.spool``, of records: length, CRC-32, bytes. Records are numbered
1, 2, 3, … for as long as the folder lives. ``stream.json`` holds the relation of these numbers to the sequence numbers
of the daemon: ``number + offset``. If the folder is full, new records are refused, and the old ones stay: a record
whose number may be on its way cannot be taken out of the sequence, or the daemon would count another one in its place.

Invariant: a record that was appended keeps its number, survives the end of this program, and is removed only when the
daemon has acknowledged it. The bytes of all segments never exceed the limit.
"""

from __future__ import annotations

import fcntl
import json
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_HEAD = struct.Struct("<II")
_SUFFIX = ".spool"
_SEGMENTS = 16
_SEGMENT_BYTES_MAX = 64 << 20
_EMPTIED_BYTES_MIN = 4 << 20


class SpoolError(OSError):
    """The folder cannot be used; the message states why."""


class Full(Exception):
    """There is no room for the record; it was not taken."""


@dataclass
class _Segment:
    path: Path
    first: int
    records: int
    bytes: int
    descriptor: int
    is_unsynced: bool = False

    @property
    def last(self) -> int:
        return self.first + self.records - 1


@dataclass(frozen=True)
class Position:
    """The begin of a record."""

    number: int
    segment_first: int
    offset: int


class Spool:
    """The spool in a folder; one program at a time. All calls may come from any thread."""

    def __init__(self, folder: str | Path, bytes_max: int) -> None:
        self.folder = Path(folder)
        self.bytes_max = bytes_max
        self._segment_bytes = max(min(bytes_max // _SEGMENTS, _SEGMENT_BYTES_MAX), 1)
        self._lock = threading.Lock()
        self.grown = threading.Condition(self._lock)
        """Notified when a record was appended, or the spool was closed."""
        self._next = 1
        self._recovered: int | None = None
        """Number of the last record that was found at the start; ``None`` once the daemon was reached."""
        self.cut_bytes = 0
        """Bytes of a record that was being written when the program or the machine stopped."""
        self._is_folder_unsynced = False
        self._is_closed = False
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._guard = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise SpoolError(f"the spool {self.folder} cannot be opened: {error}") from None
        try:
            fcntl.flock(self._guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._guard)
            raise SpoolError(
                f"another program uses the spool {self.folder}: give each node a producer, or a spool_dir, of its own"
            ) from None
        self._read_stream()
        self._segments: list[_Segment] = []
        for path in sorted(self.folder.glob(f"*{_SUFFIX}")):
            self._adopt(path)
        self._next = max(self._next, self._segments[-1].last + 1 if self._segments else 1)
        # A start that never reached the daemon has added records; the state that the first such start found counts.
        self._recovered = self._next - 1 if self._recovered is None else min(self._recovered, self._next - 1)
        try:
            self._write_stream()
        except OSError as error:
            raise SpoolError(f"the spool {self.folder} cannot be written: {error}") from None

    # Relation of numbers to sequence numbers of the daemon

    def _read_stream(self) -> None:
        self.offset: int | None = None
        """Sequence number of the daemon minus the number of the record; ``None``: the daemon was never reached."""
        self.lost = 0
        """Records that the daemon had acknowledged and no longer has: a backup was restored."""
        path = self.folder / "stream.json"
        try:
            known = json.loads(path.read_text())
            self.offset, self.lost, self._next = known["offset"], int(known["lost"]), int(known["next"])
            self._recovered = known["recovered"]
        except FileNotFoundError:
            return
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SpoolError(f"{path} cannot be read: {error}") from None

    def _write_stream(self) -> None:
        path = self.folder / "stream.json"
        fresh = path.with_suffix(".new")
        with fresh.open("w") as file:
            known = {"offset": self.offset, "lost": self.lost, "next": self._next, "recovered": self._recovered}
            json.dump(known, file)
            file.flush()
            os.fsync(file.fileno())
        fresh.rename(path)
        self._sync_folder()

    def _sync_folder(self) -> None:
        descriptor = os.open(self.folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def linked(self, durable_sequence: int) -> None:
        """The daemon has everything of this producer up to a sequence number: forgets those records.

        Before it returns, the numbers of the other records for the daemon are on the disk, so that a record never gets
        two numbers.
        """
        with self._lock:
            if self._is_closed:
                raise SpoolError(f"the spool {self.folder} is closed")
            first = self._first()
            # After a power cut the daemon may have records that this disk has lost. Records that were appended since
            # have their numbers, but other content.
            last = self._next - 1 if self._recovered is None else self._recovered
            self._recovered = None
            if self.offset is None:
                # Nothing was sent from this folder: the daemon's data comes from another folder of this producer.
                self.offset = durable_sequence - (first - 1)
            elif durable_sequence < first - 1 + self.offset:
                self.lost += first - 1 + self.offset - durable_sequence
                self.offset = durable_sequence - (first - 1)
            elif durable_sequence > last + self.offset:
                # This folder is older than the data that was sent, for example a copy: new records come behind.
                self.offset = durable_sequence - last
            self._write_stream()
            self._forget(durable_sequence - self.offset)

    # Records

    def _adopt(self, path: Path) -> None:
        """Takes a segment over; cuts off a record that was not written whole."""
        try:
            first = int(path.name.removesuffix(_SUFFIX))
            descriptor = os.open(path, os.O_RDWR)
        except (ValueError, OSError) as error:
            raise SpoolError(f"{path} is no segment of the spool: {error}") from None
        if self._segments and first != self._segments[-1].last + 1:
            os.close(descriptor)
            raise SpoolError(
                f"{path} does not follow record {self._segments[-1].last}: a file of the spool is damaged or missing. "
                f"Move {self.folder} away to begin anew; what it holds is then not sent"
            )
        whole, records = 0, 0
        size = os.fstat(descriptor).st_size
        for offset, raw in self._scan(descriptor, 0, size):
            whole, records = offset + _HEAD.size + len(raw), records + 1
        if whole < size:
            os.ftruncate(descriptor, whole)
            self.cut_bytes += size - whole
        self._segments.append(_Segment(path, first, records, whole, descriptor))

    @staticmethod
    def _scan(descriptor: int, offset: int, end: int) -> Iterator[tuple[int, bytes]]:
        """Whole records from an offset on."""
        while offset + _HEAD.size <= end:
            head = os.pread(descriptor, _HEAD.size, offset)
            if len(head) < _HEAD.size:
                return
            length, checksum = _HEAD.unpack(head)
            raw = os.pread(descriptor, length, offset + _HEAD.size) if offset + _HEAD.size + length <= end else b""
            if len(raw) != length or length == 0 or zlib.crc32(raw) != checksum:
                return
            yield offset, raw
            offset += _HEAD.size + length

    def append(self, raw: bytes) -> int:
        """Takes a record and returns its number. Raises :class:`Full`, or OSError if the disk refuses it."""
        if not raw:
            raise ValueError("a record has at least one byte")
        whole = _HEAD.pack(len(raw), zlib.crc32(raw)) + raw
        with self._lock:
            if self._is_closed:
                raise SpoolError(f"the spool {self.folder} is closed")
            if self._bytes() + len(whole) > self.bytes_max:
                raise Full(f"the spool is full: {self._bytes()} of {self.bytes_max} bytes")
            if not self._segments or self._segments[-1].bytes >= self._segment_bytes:
                self._begin_segment()
            segment = self._segments[-1]
            try:
                written = os.pwrite(segment.descriptor, whole, segment.bytes)
                if written != len(whole):
                    raise OSError(f"{written} of {len(whole)} bytes written")
            except OSError:
                os.ftruncate(segment.descriptor, segment.bytes)
                raise
            segment.bytes += len(whole)
            segment.records += 1
            number = self._next
            self._next += 1
            segment.is_unsynced = True
            self.grown.notify_all()
            return number

    def _begin_segment(self) -> None:
        path = self.folder / f"{self._next:020}{_SUFFIX}"
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
        # Not synced here: the caller that appends must not wait for the disk.
        self._segments.append(_Segment(path, self._next, 0, 0, descriptor))
        self._is_folder_unsynced = True

    def sync(self) -> None:
        """Everything appended so far survives a power cut from here on."""
        with self._lock:
            if self._is_closed:
                return
            segments = [segment for segment in self._segments if segment.is_unsynced]
            # Uses descriptors of its own, so that appending and forgetting go on meanwhile.
            descriptors = [os.dup(segment.descriptor) for segment in segments]
            is_folder_unsynced, self._is_folder_unsynced = self._is_folder_unsynced, False
            for segment in segments:
                segment.is_unsynced = False
        try:
            for descriptor in descriptors:
                os.fdatasync(descriptor)
            if is_folder_unsynced:
                self._sync_folder()
        except OSError:
            self._is_folder_unsynced = is_folder_unsynced
            for segment in segments:
                segment.is_unsynced = True
            raise
        finally:
            for descriptor in descriptors:
                os.close(descriptor)

    def acknowledged(self, sequence: int) -> None:
        """The daemon has everything up to this sequence number."""
        with self._lock:
            if self.offset is not None and not self._is_closed:
                self._forget(sequence - self.offset)

    def _forget(self, number: int) -> None:
        """Removes segments whose records all are up to ``number``."""
        while self._segments and self._segments[0].last <= number:
            segment = self._segments[0]
            if len(self._segments) == 1:
                # A small one stays for the next records: removing it costs two writes to the disk.
                if segment.bytes < min(self._segment_bytes, _EMPTIED_BYTES_MIN):
                    break
                # The numbers go on: a folder without segments would begin at 1.
                self._write_stream()
            self._segments.pop(0)
            os.close(segment.descriptor)
            segment.path.unlink()

    def read(self, at: Position | None, number: int) -> tuple[bytes, Position] | None:
        """The record of this number, and the position of the next record; ``None`` if there is no such record.

        ``at`` is the position that the last call returned; it saves a search.
        """
        with self._lock:
            if not self._first() <= number < self._next:
                return None
            segment = next((one for one in self._segments if one.first <= number <= one.last), None)
            if segment is None:
                return None
            is_there = at is not None and (at.number, at.segment_first) == (number, segment.first)
            current, offset = (number, at.offset) if is_there and at is not None else (segment.first, 0)
            for place, raw in self._scan(segment.descriptor, offset, segment.bytes):
                if current == number:
                    return raw, Position(number + 1, segment.first, place + _HEAD.size + len(raw))
                current += 1
            raise SpoolError(f"record {number} of {segment.path} is damaged on the disk")

    # Fill level

    def _bytes(self) -> int:
        return sum(segment.bytes for segment in self._segments)

    def _first(self) -> int:
        """Number of the oldest record that is kept, or of the next one."""
        return self._segments[0].first if self._segments and self._segments[0].records else self._next

    @property
    def bytes(self) -> int:
        """Bytes of all segments."""
        with self._lock:
            return self._bytes()

    @property
    def last(self) -> int:
        """Number of the last record that was appended; 0: none ever."""
        with self._lock:
            return self._next - 1

    @property
    def first(self) -> int:
        """Number of the oldest record that is kept, or of the next one."""
        with self._lock:
            return self._first()

    def close(self) -> None:
        """Ends; appended records are on the disk."""
        self.sync()
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
            self.grown.notify_all()
            for segment in self._segments:
                os.close(segment.descriptor)
            self._segments.clear()
            os.close(self._guard)
