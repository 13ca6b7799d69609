"""Writing of an MCAP file by appending only, so that it can be read up to its last complete chunk at any
time.

Layout (MCAP specification): magic, header, data section (schemas, channels, chunks with their message
indexes, attachments, metadata), DataEnd with a CRC, summary (copies of schemas and channels, chunk indexes,
statistics), footer, magic. A file that was cut short lacks everything after its last chunk; a reader then
walks through the data section.

The mcap library serialises the small records. Chunks are built here, because the library's writer has a
single open chunk for all topics and a fixed compression level (decision 6).
"""

import contextlib
import errno
import json
import os
import random
import secrets
import shutil
import sys
import tempfile
import threading
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import zstandard
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from acquisition.record.chunk_builder import ChunkBuilder
from acquisition.record.records import CHUNK_HEAD, INDEX_HEAD, MAGIC, OWN_SHA256, ZSTD, sha256_of_description
from acquisition.record.summary import Summary, serialised, shortest_ending
from acquisition.record.topics import LIBRARY, METADATA_COPY
from acquisition.record.whole_file import sync_folder
from processing.errors import RecordError

_ZSTD_LEVEL = 1
_HURRIED_ZSTD_LEVEL = -10
"""Takes a quarter of the time for frames of 12 bits, and saves almost nothing of their size."""
_FULL_DISK = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}
_SPARE_BYTES = 64 * 1024
_RESERVE_STEP_BYTES = 1024 * 1024


class BackgroundSync:
    """Forces a file to the disk in a thread, so that the thread that writes it does not wait.

    It runs `action` on request; all requests during a run are answered by one further run.

    The thread ends when there is nothing left to do, so that a record that is never closed leaves no thread.
    An OSError of the action is kept until `take_failure`.
    """

    def __init__(self, action: Callable[[], None]) -> None:
        self._action = action
        self._lock = threading.Lock()
        self._asked = False
        self._thread: threading.Thread | None = None
        self._failure: OSError | None = None

    def request(self) -> None:
        """Start a run of the action after this call, as soon as possible; does not wait for it."""
        with self._lock:
            self._asked = True
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="record sync", daemon=True)
                self._thread.start()

    def wait(self) -> None:
        """Wait until all requested runs have ended."""
        thread = self._thread
        if thread is not None:
            thread.join()

    def take_failure(self) -> OSError | None:
        """First error since the last call, or None."""
        with self._lock:
            failure, self._failure = self._failure, None
        return failure

    def _work(self) -> None:
        while True:
            with self._lock:
                if not self._asked:
                    self._thread = None
                    return
                self._asked = False
            try:
                self._action()
            except OSError as error:
                with self._lock:
                    self._failure = self._failure or error


class Reserve:
    """Disk space that is released when the disk is full, so that a record can still be finished.

    It is a nameless temporary file beside the record: a kill frees it, nothing is left behind.

    Filled with random bytes, which no file system compresses away. Raises OSError where the room
    does not exist.
    """

    def __init__(self, folder: Path, size: int) -> None:
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 lives as long as the record
        self._random = random.Random(0)
        self.size = 0
        try:
            self.hold(size)
        except OSError:
            self.release()
            raise

    def hold(self, size: int) -> None:
        """Make it at least so large."""
        while not self._file.closed and self.size < size:
            written = self._file.write(self._random.randbytes(min(_RESERVE_STEP_BYTES, size - self.size)))
            self.size += written or 0
            os.fsync(self._file.fileno())

    def release(self) -> bool:
        """Give the room back; False where that was done before."""
        if self._file.closed:
            return False
        try:
            self._file.truncate(0)
        finally:
            self._file.close()
        self.size = 0
        return True


class McapFile:
    """Creates a file and appends to it.

    A record that could not be written completely is cut off again, so that the file always ends with a
    complete one. If the disk is full, the reserve is released, the record is written, and `full` holds the
    error: the owner must then finish the file.

    Raises OSError if the file exists or cannot be created or there is no space for the reserve; later, if it
    cannot be written (disk full after the release of the reserve, drive removed).
    """

    def __init__(self, path: Path, reserve_bytes: int) -> None:
        self.full: OSError | None = None
        self.size = 0
        self._crc = 0
        self._summary = Summary()
        self._copies: list[tuple[Attachment, bytes]] = []
        self._reserve_bytes = reserve_bytes
        self._reserve_lock = threading.Lock()
        self._background = BackgroundSync(self._force)
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        self._hurried = zstandard.ZstdCompressor(level=_HURRIED_ZSTD_LEVEL)
        self._path = path
        # also readable, so that a record whose name was removed can be copied
        self._file = path.open("x+b", buffering=0)
        try:
            self._reserve = Reserve(path.parent, reserve_bytes)
            self._append(MAGIC + serialised(Header("", LIBRARY)))
            sync_folder(path.parent)
        except OSError:
            self._file.close()
            path.unlink()
            raise

    @property
    def end_ns(self) -> int:
        """Latest log time of all chunks; 0 without any."""
        return self._summary.end_ns

    def add_metadata(self, sections: Mapping[str, Mapping[str, str]], log_time_ns: int) -> None:
        """All metadata, texts by key by section; as an attachment, too, because that has a checksum."""
        for name, texts in sections.items():
            data = serialised(Metadata(name, dict(texts)))
            self._summary.add_metadata(self.size, len(data), name)
            self._append(data)
        copy = json.dumps({name: dict(texts) for name, texts in sections.items()}, ensure_ascii=False)
        for _ in range(2):
            # two of them before the chunks, for a file that is cut
            self.add_attachment(METADATA_COPY, "application/json", copy.encode(), log_time_ns)

    def add_attachment(self, name: str, media_type: str, data: bytes, log_time_ns: int) -> None:
        """A file within the file. The end of a finished file holds it once more."""
        attachment = Attachment(log_time_ns, log_time_ns, name, media_type, data)
        record = serialised(attachment)
        self._copies.append((attachment, record))
        self._attach(attachment, record)

    def _attach(self, attachment: Attachment, record: bytes) -> None:
        place = self.size
        self._append(record)
        self._summary.add_attachment(place, len(record), attachment)

    def add_channel(self, topic: str, schema_name: str, descriptor: bytes) -> int:
        """Add a channel of protobuf messages.

        It is written outside the chunks, so that each chunk can be read without the others, and twice, so
        that one changed bit of a file without its ending does not make the topic unreadable.
        """
        number = len(self._summary.channels) + 1
        schema = Schema(number, descriptor, "protobuf", schema_name)
        channel = Channel(number, topic, "protobuf", {}, number)
        channel.metadata[OWN_SHA256] = sha256_of_description(channel, schema)
        self._summary.schemas.append(schema)
        self._summary.channels.append(channel)
        self._append(2 * (serialised(schema) + serialised(channel)))
        return number

    def add_chunk(self, builder: ChunkBuilder, *, hurried: bool = False) -> None:
        """Compress the builder's messages, append them as a chunk and clear the builder; nothing if empty.

        `hurried` compresses less, in less time.
        """
        if not builder.data:
            return
        compressed = (self._hurried if hurried else self._compressor).compress(builder.data)
        head = CHUNK_HEAD.pack(
            Opcode.CHUNK,
            CHUNK_HEAD.size - 9 + len(compressed),
            builder.start_ns,
            builder.end_ns,
            len(builder.data),
            zlib.crc32(builder.data),
            len(ZSTD),
            ZSTD,
            len(compressed),
        )
        chunk_start = self.size
        chunk_length = len(head) + len(compressed)
        offsets: dict[int, int] = {}
        parts: list[bytes | bytearray] = [head, compressed]
        place = chunk_start + chunk_length
        for channel, entries in builder.index.items():
            offsets[channel] = place
            parts += [
                INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)),
                entries,
            ]
            place += INDEX_HEAD.size + len(entries)
        self._append(b"".join(parts))
        index_bytes = place - chunk_start - chunk_length
        self._summary.add_chunk(builder, chunk_start, chunk_length, len(compressed), offsets, index_bytes)
        builder.clear()

    def sync(self, wait: bool = True) -> None:
        """Flush the file to the disk, and adapt the reserve to the size of the file's ending.

        Without `wait` this is done in a background thread, so that a slow disk does not delay what is
        appended meanwhile. Errors of that thread are raised by `raise_failure`.
        """
        if wait:
            self._background.wait()
            self.raise_failure()
            self._force()
        else:
            self._background.request()

    def raise_failure(self) -> None:
        """Raise, once, the error of a `sync` in the background."""
        failure = self._background.take_failure()
        if failure is not None:
            raise failure

    def finish(self) -> None:
        """Write the summary (or only a minimal ending if there is no space for it) and close the file."""
        self._background.wait()
        try:
            try:
                for attachment, record in self._copies:
                    self._attach(attachment, record)
                self._append(self._summary.ending(self.size, self._crc))
            except OSError as error:
                if error.errno not in _FULL_DISK:
                    raise
                self._append(shortest_ending(self._crc))
            _sync_file(self._file.fileno())
            if not self._has_its_name():
                self._copy_to_its_name()
            self.raise_failure()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file without an ending; never raises."""
        self._background.wait()
        with contextlib.suppress(OSError):
            self._reserve.release()
        with contextlib.suppress(OSError):
            self._file.close()

    def _append(self, data: bytes) -> None:
        try:
            self._write_whole(data)
        except OSError as error:
            self._cut_off()
            if not self._give_reserve_back(error):
                raise
            try:
                self._write_whole(data)
            except OSError:
                self._cut_off()
                raise
        self.size += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _write_whole(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) or 0 :]

    def _cut_off(self) -> None:
        with contextlib.suppress(OSError):
            self._file.truncate(self.size)
            self._file.seek(self.size)

    def _force(self) -> None:
        if not self._has_its_name():
            raise OSError(errno.ENOENT, "the file was removed or renamed while it was written")
        try:
            with self._reserve_lock:
                needed = self._reserve_bytes + len(self._summary.chunk_index) + _SPARE_BYTES
                if self.full is None and self._reserve.size < needed:
                    # in steps, because each increase is a write to the disk
                    self._reserve.hold(needed + _SPARE_BYTES)
            _sync_file(self._file.fileno())
        except OSError as error:
            if not self._give_reserve_back(error):
                raise
            _sync_file(self._file.fileno())

    def _has_its_name(self) -> bool:
        """Whether the path still names this file."""
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        except FileNotFoundError:
            return False

    def _copy_to_its_name(self) -> None:
        """Save the content of a file that was removed: it lives only as long as it is open."""
        path = self._path
        if os.path.lexists(path):
            path = path.with_name(f"{path.stem}-{secrets.token_hex(4)}{path.suffix}")
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file.seek(0)
        with path.open("xb") as copy:
            shutil.copyfileobj(self._file, copy)
            copy.flush()
            _sync_file(copy.fileno())
        sync_folder(path.parent)

    def _give_reserve_back(self, error: OSError) -> bool:
        if error.errno not in _FULL_DISK:
            return False
        with self._reserve_lock:
            self.full = self.full or error
            return self._reserve.release()


def create_record(path: Path, reserve_bytes: int) -> McapFile:
    """Create the file of a record. Raises RecordError if it exists or cannot be created."""
    try:
        return McapFile(path, reserve_bytes)
    except FileExistsError:
        raise RecordError(f"{path}: exists already and is never overwritten; choose another name") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be created: {error.strerror or error}") from None


def _sync_file(number: int) -> None:
    """Flush to the disk; on macOS fsync alone leaves data in the drive's cache."""
    if sys.platform == "darwin":
        import fcntl

        fcntl.fcntl(number, fcntl.F_FULLFSYNC)
    else:
        os.fsync(number)
