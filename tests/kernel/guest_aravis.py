"""Runs in the guest with the system's Python: reads the camera through libaravis."""

import json
import sys

try:
    import gi

    gi.require_version("Aravis", "0.8")
    from gi.repository import Aravis
except (ImportError, ValueError) as missing:
    sys.exit(f"libaravis or PyGObject is missing: {missing}")

Aravis.update_device_list()
camera = Aravis.Camera.new(Aravis.get_device_id(0))
camera.set_region(0, 0, 320, 240)
camera.set_exposure_time(200.0)
stream = camera.create_stream(None, None)
for _ in range(10):
    stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
camera.start_acquisition()
frames = []
while len(frames) < 20:
    buffer = stream.timeout_pop_buffer(5_000_000)
    if buffer is None:
        sys.exit("no frame within 5 s")
    data = buffer.get_data()
    frames.append(
        {
            "status": buffer.get_status().value_nick,
            "id": buffer.get_frame_id(),
            "size": len(data),
            "first": list(data[:4]),
            "last": list(data[-2:]),
            "timestamp_ns": buffer.get_timestamp(),
            "width": buffer.get_image_width(),
        }
    )
    stream.push_buffer(buffer)
camera.stop_acquisition()
print(
    json.dumps(
        {
            "vendor": camera.get_vendor_name(),
            "serial": camera.get_device_serial_number(),
            "exposure_us": camera.get_exposure_time(),
            "region": list(camera.get_region()),
            "frames": frames,
        }
    )
)
