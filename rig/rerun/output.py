"""The stream into which a worker draws: an .rrd file, or a live stream on 127.0.0.1."""

import sys
import threading
import time
import traceback
from pathlib import Path

import rerun as rr

from rig.rerun import layout
from rig.rerun.drawing import Drawing
from rig.rerun.messages import Message, Setup, Trouble
from rig.rerun.ports import free_port, hidden_loopback

LIVE_GATHER_S, LIVE_GATHER_ROWS, LIVE_PICTURE_S = 0.2, 2000, 0.1
FILE_GATHER_S, FILE_GATHER_ROWS, FILE_PICTURE_S = 10.0, 8000, 10.0
FLUSH_INTERVAL_S = 2.0
FLUSH_LIMIT_S = 5.0
VIEWER_TRIES = 10


class Output:
    """Opens a stream and draws into it.

    If a file cannot be written (full disk), a note says so and later messages are ignored. If a live stream
    does not transmit its data, an exception ends the worker: its successor opens a new server, so that a
    viewer that hangs cannot block it.
    """

    def __init__(self, setup: Setup) -> None:
        self.url = ""
        self.port = setup.port
        self._setup = setup
        self._notes: list[tuple[str, Trouble]] = []
        self._failed = False
        self._flushed_at = time.monotonic()
        self._stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=setup.recording_id)
        sink = rr.FileSink(Path(setup.rrd_path)) if setup.rrd_path else self._live_sink()
        blueprint = layout.blueprint(setup)
        live = setup.rrd_path is None
        try:
            self._stream.set_sinks(sink, default_blueprint=blueprint)
            self._stream.send_recording_name(setup.title)
            self._drawing = Drawing(
                self._stream,
                setup,
                gather_s=LIVE_GATHER_S if live else FILE_GATHER_S,
                gather_rows=LIVE_GATHER_ROWS if live else FILE_GATHER_ROWS,
                picture_interval_s=LIVE_PICTURE_S if live else FILE_PICTURE_S,
            )
        except RuntimeError as error:
            self._fail(error)
        if setup.viewer_url:
            threading.Thread(target=self._connect_viewer, daemon=True).start()

    def take_notes(self) -> list[tuple[str, Trouble]]:
        """Remarks for the user since the last call, and what each is about."""
        notes, self._notes = self._notes, []
        return notes

    def draw(self, messages: list[Message]) -> bool:
        """Draw the messages; False if the stream can no longer be written."""
        if self._failed:
            return False
        for message in messages:
            try:
                self._drawing.draw(message)
            except (ValueError, TypeError, RuntimeError) as error:
                traceback.print_exc(file=sys.stderr)
                what = f"view: a {type(message).__name__} could not be drawn: {error}"
                self._notes.append((what, Trouble.NOT_DRAWN))
        self._drawing.send()
        if time.monotonic() - self._flushed_at > FLUSH_INTERVAL_S:
            self._flush()
        return not self._failed

    def finish(self) -> None:
        """Send what was gathered and complete the stream."""
        if not self._failed:
            self._drawing.send(now=True)
            self._flush()
        if not self._failed:
            self._stream.disconnect()

    def _live_sink(self) -> rr.GrpcServerSink:
        setup = self._setup
        host = hidden_loopback()
        self.port = free_port(setup.port, host)
        if setup.port not in (0, self.port):
            where = f"the live view listens on {host}:{self.port}"
            self._notes.append((f"port {setup.port} is in use: {where}", Trouble.NONE))
        sink = rr.GrpcServerSink(host, self.port, server_memory_limit=setup.memory_limit)
        self.url = sink.uri
        return sink

    def _flush(self) -> None:
        self._flushed_at = time.monotonic()
        try:
            self._stream.flush(timeout_sec=FLUSH_LIMIT_S)
        except (RuntimeError, TimeoutError) as error:
            if self._setup.rrd_path is None:
                raise
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._failed = True
        where = f"the Rerun file {self._setup.rrd_path}" if self._setup.rrd_path else "the live view"
        trouble = Trouble.FILE_ENDED if self._setup.rrd_path else Trouble.LIVE_ENDED
        self._notes.append((f"{where} is no longer written (the record is not affected): {error}", trouble))

    def _connect_viewer(self) -> None:
        """Connect the viewer of the previous stream to this one; the viewer may hang or have been closed."""
        from rerun.experimental import ViewerClient

        problem: Exception | None = None
        for _ in range(VIEWER_TRIES):
            try:
                viewer = ViewerClient.connect(self._setup.viewer_url)
                viewer.open(self.url)
                # The viewer rejects this until the first data have arrived.
                viewer.set_time(layout.TIMELINE, play_state="following")
                return
            except (RuntimeError, OSError, ValueError) as error:
                problem = error
                time.sleep(1.0)
        print(f"the viewer at {self._setup.viewer_url} cannot be reconnected: {problem}", file=sys.stderr)
