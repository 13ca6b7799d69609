"""Latency and pace of a run in real time, from a camera in memory: alone, and with desk and viewer.

Run as ``python -m tests.benchmarks pace [--quick]`` from the repository. The ways are measured in turns, for
other work on the machine disturbs them; its load stands beside each figure.
"""

import http.client
import os
import resource
import tempfile
import threading
import time
import urllib.parse
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from acquisition.camera import CameraSettings
from acquisition.record.writer import RecordWriter
from calibration.axes_fit import Axes
from calibration.light_lever import Lever
from processing.spot import SensorModel
from rig.devices import Devices, OrderSocket, SessionNews
from rig.devices.frame_stream import FrameStream
from rig.devices.session_devices import OpenCamera
from rig.instrument.pipeline import Optics
from rig.instrument.provenance import prepare_kernels
from rig.instrument.run_now import RunNow
from rig.measure.recorder import Recorder
from rig.measure.run import MeasurementRun
from rig.measure.run_parts import RunPlan, ready_for_frames
from rig.measure.run_status import Watcher
from rig.measure.screen import RunDisplay
from rig.settings import load_configuration, validate_configuration
from rig.view import RunningView
from tests.benchmarks.memory_camera import FULL_SCALE_DN, MemoryCamera, drawn_frames
from tests.rig.desk.desk_page import DeskProcess


class Case(NamedTuple):
    """Frames of a size and rate."""

    width: int
    height: int
    rate_hz: float

    def __str__(self) -> str:
        return f"{self.rate_hz:g}/s of {self.width}x{self.height}"


WAYS = ("alone", "with desk and viewer")
PICTURES_HZ = 5.0
_BEGIN_S = 0.5
CASES = (Case(640, 480, 500.0), Case(256, 256, 2000.0), Case(640, 480, 1000.0))


class Company(NamedTuple):
    """What watches the run."""

    watchers: Sequence[Watcher] = ()
    news: SessionNews | None = None
    show: Callable[[RunNow], None] = lambda _: None


@contextmanager
def looked_at(source: Path) -> Iterator[None]:
    """`rig desk` in a process, and a thread that asks it for five pictures a second, as a browser does."""
    desk, ended = DeskProcess(source), threading.Event()
    address = urllib.parse.urlsplit(desk.address)
    key = urllib.parse.parse_qs(address.query)["key"][0]
    headers = {"Cookie": f"rig_desk_{address.port}={key}"}

    def look() -> None:
        connection = http.client.HTTPConnection("127.0.0.1", address.port or 0, timeout=10)
        due_s = time.monotonic()
        while not ended.wait(max(0.0, due_s - time.monotonic())):
            due_s = max(due_s + 1 / PICTURES_HZ, time.monotonic())
            connection.request("GET", "/picture?width=800&height=540", headers=headers)
            connection.getresponse().read()

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        desk.kill()


def real_time(case: Case, duration_s: float, company: Company, *, viewed: bool) -> dict[str, Any]:
    """One run in real time: frames lost, latency from frame to record, share of one core.

    The latency runs from the moment when a frame is due to the end of the recorder's write call for it; part
    of it is `taken`, the time until the camera's thread has the frame. The kernels are ready before the
    first frame, as they are in ``rig run``. The frames of the first `_BEGIN_S` wait until the record has been
    created and is on the disk, and are told apart.
    """
    rate_hz = case.rate_hz
    frames = drawn_frames(case.width, case.height, rate_hz, round(min(2.0 * rate_hz, 600)))
    latencies_ms: list[float] = []
    begin_ms: list[float] = []
    written: list[tuple[int, int]] = []
    write_spots, write_next = RecordWriter.write_spots, Recorder._write_next

    def noted(
        writer: RecordWriter, numbers: Sequence[int], device_times_ns: Sequence[int], *rest: Any
    ) -> None:
        write_spots(writer, numbers, device_times_ns, *rest)
        written.extend(zip(numbers, device_times_ns, strict=True))

    def timed(recorder: Recorder) -> None:
        write_next(recorder)
        now_ns = time.monotonic_ns()
        for number, due_ns in written:
            into = begin_ms if number < _BEGIN_S * rate_hz else latencies_ms
            into.append((now_ns - due_ns) * 1e-6)
        written.clear()

    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        if viewed:
            view = RunningView(Path(folder) / "run.mcap", "web", "measuring")
            stack.callback(view.close)
        camera = MemoryCamera(frames, rate_hz, duration_s)
        opened = OpenCamera(camera, camera.open(), ())
        sensor = SensorModel(10_000.0 / FULL_SCALE_DN, 7.0, FULL_SCALE_DN)
        prepare_kernels(sensor, print)
        lever = Lever(arm_m=1.0, pixel_pitch_m=4.8e-6)
        optics = Optics(sensor, lever, Axes())
        config = validate_configuration(
            {"camera": {"driver": "simulated"}, "session": {"max_duration_s": 1e9}}, ""
        )
        config = config.model_copy(update={"lever": lever})
        run = MeasurementRun(
            plan=RunPlan(
                config,
                Path(),
                Path(folder) / "run.mcap",
                "run 1",
                session_news=company.news or SessionNews(),
            ),
            camera=opened,
            optics=optics,
            stream=FrameStream(camera, CameraSettings()),
            devices=Devices(config),
            watchers=company.watchers,
        )
        stack.enter_context(patch.object(RecordWriter, "write_spots", noted))
        stack.enter_context(patch.object(Recorder, "_write_next", timed))
        before = resource.getrusage(resource.RUSAGE_SELF)
        began_s = time.monotonic()
        with ready_for_frames(live=True):
            outcome = run.execute(company.show)
        elapsed_s = time.monotonic() - began_s
        if outcome.failure is not None:
            raise outcome.failure
        after = resource.getrusage(resource.RUSAGE_SELF)
        size = (Path(folder) / "run.mcap").stat().st_size
    camera.close()
    busy_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    taken_ms = np.array(camera.late_ns) * 1e-6
    return {
        "frames": outcome.last.frames,
        "dropped": outcome.last.dropped_frames,
        "taken_p99_ms": float(np.percentile(taken_ms, 99)),
        "taken_max_ms": float(np.max(taken_ms)),
        "latency_p50_ms": float(np.percentile(latencies_ms, 50)),
        "latency_p99_ms": float(np.percentile(latencies_ms, 99)),
        "latency_max_ms": float(np.max(latencies_ms)),
        "begin_max_ms": float(np.max(begin_ms)),
        "cores": busy_s / elapsed_s,
        "record_mb_per_s": size / elapsed_s / 1e6,
    }


@contextmanager
def desk_and_viewer() -> Iterator[Company]:
    """A desk that asks for five pictures a second, and a live page, as with mode "web"."""
    with tempfile.TemporaryDirectory() as place, ExitStack() as stack:
        folder = Path(place) / "session"
        folder.mkdir()
        source = Path(place) / "rig.toml"
        source.write_text(
            f'[session]\noutput = "{place}"\n[camera]\ndriver = "simulated"\n', encoding="utf-8"
        )
        config = load_configuration(source)
        news = SessionNews()
        news.begin_run("benchmark", 255, None)
        display = RunDisplay("benchmark", 2.0, config.deflection_unit)

        def show(now: RunNow) -> None:
            news.state(display.values(now), display.facts(now))

        stack.enter_context(OrderSocket(folder, news, {}))
        stack.enter_context(looked_at(source))
        yield Company([display], news, show)


def measured(case: Case, seconds: float, way: str) -> dict[str, Any]:
    """One run, with the load of the machine beside it."""
    with ExitStack() as stack:
        watched = way == "with desk and viewer"
        company = stack.enter_context(desk_and_viewer()) if watched else Company()
        found = real_time(case, seconds, company, viewed=watched)
    return found | {"load": os.getloadavg()[0]}


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers of this topic."""
    seconds, turns = (5.0, 1) if quick else (30.0, 2)
    results: dict[str, Any] = {}
    for case in CASES:
        for _ in range(turns):
            for way in WAYS:
                results.setdefault(f"{case}, {way}", []).append(measured(case, seconds, way))
    return results


def slowest(seconds: int) -> dict[str, list[dict[str, float]]]:
    """The first of the cases alone, twice in every way."""
    return {way: [measured(CASES[0], seconds, way) for _ in range(2)] for way in WAYS}
