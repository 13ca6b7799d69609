"""A program that switches the laser on and then ends in a given way; run by the safety tests."""

import sys
import time

from rig.control.controller import Controller
from rig.control.service import ControlService
from rig.control.settings import ControllerSettings


def main(port: str, ending: str) -> None:
    settings = ControllerSettings(kind="serial", port=port, timeout_s=0.5, heartbeat_s=0.1, watchdog_s=1.5)
    service = ControlService(Controller(settings, 0.001), settings)
    service.start()
    service.wait_open(10.0)
    service.set_laser_power_w(0.0005).result(5.0)
    service.laser_on().result(5.0)
    service.submit(lambda c: c.hold()).result(5.0)
    service.submit(lambda c: c.brake(False)).result(5.0)
    print("lit", flush=True)
    sys.stdin.readline()
    if ending == "raises":
        raise RuntimeError("the program's own fault")
    if ending == "closes":
        service.close()
    time.sleep(60.0)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
