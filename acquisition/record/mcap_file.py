"""An MCAP file that is being written, on a disk that may fill up, be slow or be removed."""

import contextlib
import errno
import json
import os
import random
import secrets
import shutil
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import Footer
from mcap.writer import MCAP0_MAGIC, Writer
from mcap_protobuf.schema import register_schema

from acquisition.atomic_write import atomic_file, sync_file, sync_folder
from acquisition.record.digest import lock_for_writing
from acquisition.record.schemas import MessageType
from acquisition.record.topics import LIBRARY, METADATA_COPY, Topics
from processing.errors import RecordError

_CHUNK_BYTES = 1024 * 1024
_FULL_DISK = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}
_INDEX_BYTES = 512
"""Upper limit of a chunk's entry in the file's ending, about 100 bytes and 10 for each topic."""
_RESERVE_STEP_BYTES = 1024 * 1024
"""Bytes by which the reserve grows at once."""
_SPARE_BYTES = 64 * 1024
"""Bytes of the reserve beyond the ending, so that it need not grow with every chunk."""


class Reserve:
    """Disk space that is released when the disk is full, so that a record can still be finished.

    It is a nameless temporary file beside the record: a kill frees it, nothing is left behind. It is filled
    with random bytes, which no file system compresses away. Raises OSError where there is no space for it.
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
        """Enlarge to `size` bytes."""
        while not self._file.closed and self.size < size:
            written = self._file.write(self._random.randbytes(min(_RESERVE_STEP_BYTES, size - self.size)))
            self.size += written or 0
            os.fsync(self._file.fileno())

    def release(self) -> bool:
        """Free the space; False if that was done before."""
        if self._file.closed:
            return False
        try:
            self._file.truncate(0)
        finally:
            self._file.close()
        self.size = 0
        return True


class Disk:
    """The stream under the library's writer; data that could not be written completely are cut off again.

    Attributes
    ----------
    full
        Error of a full disk. The reserve was then released and the bytes were written; the owner must finish
        the file.
    broken
        Whether any other error has occurred, after which the library's writer cannot go on.
    size, chunks
        Length of the file so far in bytes, and number of its chunks.
    """

    def __init__(self, path: Path, reserve_bytes: int) -> None:
        self.full: OSError | None = None
        self.broken = False
        self.size = 0
        self.chunks = 0
        self._path = path
        self._reserve_bytes = reserve_bytes
        self._reserve_lock = threading.Lock()
        self._flusher: threading.Thread | None = None
        self._failure: OSError | None = None
        # also readable, so that a record whose name was removed can be copied
        self._file = path.open("x+b", buffering=0)
        lock_for_writing(self._file.fileno())
        try:
            self._reserve = Reserve(path.parent, reserve_bytes)
        except OSError:
            self._file.close()
            path.unlink()
            raise

    def tell(self) -> int:
        """Length of the file."""
        return self.size

    def flush(self) -> None:
        """Do nothing: every write is a write to the file."""

    def write(self, data: bytes) -> int:
        """Append all of the data, or nothing. Raises OSError."""
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[self._file.write(rest) or 0 :]
            except OSError as error:
                with contextlib.suppress(OSError):
                    self._file.truncate(self.size)
                    self._file.seek(self.size)
                if not self._release_reserve(error):
                    self.broken = True
                    raise
                rest = memoryview(data)
        self.size += len(data)
        return len(data)

    def sync(self, wait: bool) -> None:
        """Flush the file to the disk in a thread, and adapt the reserve to the size of the file's ending.

        Without `wait` a thread of an earlier call that still runs is enough. Raises the OSError of the
        thread, once.
        """
        if wait:
            self.wait_for_sync()
        self._raise_failure()
        if self._flusher is None or not self._flusher.is_alive():
            self._flusher = threading.Thread(target=self._sync, name="record sync", daemon=True)
            self._flusher.start()
        if wait:
            self.wait_for_sync()
            self._raise_failure()

    def _raise_failure(self) -> None:
        """Raise, once, the error of the thread."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def wait_for_sync(self) -> None:
        """Wait until nothing is flushed any more."""
        if self._flusher is not None:
            self._flusher.join()

    def _sync(self) -> None:
        try:
            if not self._has_its_name():
                raise OSError(errno.ENOENT, "the file was removed or renamed while it was written")
            try:
                with self._reserve_lock:
                    needed_bytes = self._reserve_bytes + _INDEX_BYTES * self.chunks + _SPARE_BYTES
                    if self.full is None and self._reserve.size < needed_bytes:
                        # in steps, because each increase is a write to the disk
                        self._reserve.hold(needed_bytes + _SPARE_BYTES)
                sync_file(self._file.fileno())
            except OSError as error:
                if not self._release_reserve(error):
                    raise
                sync_file(self._file.fileno())
        except OSError as error:
            self._failure = self._failure or error

    def last_sync(self) -> None:
        """Flush the finished file; if its name was removed, copy it to its name. Raises what `sync` left."""
        sync_file(self._file.fileno())
        if not self._has_its_name():
            self._copy_to_its_name()
        self._raise_failure()

    def close(self) -> None:
        """Close file and reserve; never raises."""
        with contextlib.suppress(OSError):
            self._reserve.release()
        with contextlib.suppress(OSError):
            self._file.close()

    def _has_its_name(self) -> bool:
        """Whether the path still names this file."""
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        except FileNotFoundError:
            return False

    def _copy_to_its_name(self) -> None:
        """Save the content of a removed file, which the system keeps only as long as the file is open."""
        path = self._path
        if os.path.lexists(path):
            path = path.with_name(f"{path.stem}-{secrets.token_hex(4)}{path.suffix}")
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file.seek(0)
        with atomic_file(path) as temporary, temporary.open("wb") as copy:
            shutil.copyfileobj(self._file, copy)

    def _release_reserve(self, error: OSError) -> bool:
        """Free the reserve if the error is a full disk; False where there is none to free."""
        if error.errno not in _FULL_DISK:
            return False
        with self._reserve_lock:
            self.full = self.full or error
            return self._reserve.release()


class McapFile:
    """Creates one MCAP file and appends to it; it can be read up to its last complete chunk at any time.

    The channels are 1, 2, ... in the order of `topics`. Every chunk has a checksum, and the data section too.
    `waiting` is the number of messages in the open chunk, which are lost where its `disk` is broken. Raises
    RecordError where the file exists or cannot be created, or there is no space for the reserve; later
    methods raise OSError where it cannot be written (disk full without a reserve, drive removed).
    """

    def __init__(self, path: Path, topics: Topics, reserve_bytes: int) -> None:
        try:
            self.disk = Disk(path, reserve_bytes)
        except FileExistsError:
            raise RecordError(
                f"{path}: exists already and is never overwritten; choose another name"
            ) from None
        except OSError as error:
            raise RecordError(f"{path}: cannot be created: {error.strerror or error}") from None
        self._attachments: list[tuple[int, str, str, bytes]] = []
        self.waiting = 0
        self._writer = Writer(
            self.disk,  # type: ignore[arg-type]
            chunk_size=_CHUNK_BYTES,
            enable_data_crcs=True,
        )
        self.channels: dict[str, int] = {}
        for topic, kind in topics.items():
            number = (
                self._writer.register_schema(kind.full_name, "protobuf", kind.descriptor)
                if isinstance(kind, MessageType)
                else register_schema(self._writer, kind)
            )
            self.channels[topic] = self._writer.register_channel(topic, "protobuf", number)
        try:
            self._writer.start("", LIBRARY)
            sync_folder(path.parent)
        except OSError as error:
            self.abandon()
            path.unlink()
            raise RecordError(f"{path}: cannot be created: {error.strerror or error}") from None

    def add(self, topic: str, sequence: int, log_time_ns: int, data: bytes) -> None:
        """Append one encoded message to the open chunk, which is written when it is large enough."""
        channel, size = self.channels[topic], self.disk.size
        self._writer.add_message(channel, log_time_ns, data, log_time_ns, sequence & 0xFFFFFFFF)
        self.waiting = self.waiting + 1 if self.disk.size == size else 0

    def add_metadata(self, metadata: Mapping[str, Mapping[str, str]], time_ns: int) -> None:
        """Append metadata (texts by key, by section), and two copies as attachments, which have checksums."""
        for name, texts in metadata.items():
            self._writer.add_metadata(name, dict(texts))
        copy = json.dumps({name: dict(texts) for name, texts in metadata.items()}, ensure_ascii=False)
        for _ in range(2):
            # two, so that one changed bit of a truncated file does not make it unreadable
            self.add_attachment(METADATA_COPY, "application/json", copy.encode(), time_ns)

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Append an attached file, with a checksum; `finish` writes a second copy at the end."""
        self._attachments.append((time_ns, name, media_type, data))
        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)

    def flush(self, wait: bool = True) -> None:
        """End the open chunk and force the file to the disk.

        Without `wait` this is done in a background thread, so that a slow disk does not delay what is
        appended meanwhile. Errors of that thread are raised by a later call.
        """
        self.disk.chunks += bool(self.waiting)
        self._writer.flush()  # type: ignore[no-untyped-call]
        self.waiting = 0
        self.disk.sync(wait)

    def finish(self) -> None:
        """Write summary and ending, or only the shortest ending if there is no space for them, and close."""
        try:
            self.disk.wait_for_sync()
            try:
                if not self.disk.broken:
                    for time_ns, name, media_type, data in self._attachments:
                        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)
                    self._writer.finish()  # type: ignore[no-untyped-call]
            except OSError as error:
                if error.errno not in _FULL_DISK:
                    raise
            if self.disk.broken:
                builder = RecordBuilder()
                Footer(0, 0, 0).write(builder)
                self.disk.write(builder.end() + MCAP0_MAGIC)  # type: ignore[no-untyped-call]
            self.disk.last_sync()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file without an ending; never raises."""
        self.disk.wait_for_sync()
        self.disk.close()
