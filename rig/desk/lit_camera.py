"""A camera whose frames keep the light permitted: where they stop, the laser goes dark."""

from acquisition.camera import Camera, CameraInfo, CameraSettings, CameraStatus
from acquisition.frame import Frame
from rig.control import LightPermit, Stage


class LitCamera:
    """An open camera that tells the laser's permit of each frame; it is opened and closed by who gave it."""

    def __init__(self, camera: Camera, info: CameraInfo, permit: LightPermit) -> None:
        self._camera, self._info, self._permit = camera, info, permit

    def open(self) -> CameraInfo:
        return self._info

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return self._camera.configure(settings)

    def start(self) -> None:
        self._camera.start()

    def read(self, timeout_s: float) -> Frame | None:
        frame = self._camera.read(timeout_s)
        # whoever reads looks at once
        for stage in (Stage.CAMERA, Stage.PROCESSING):
            self._permit.moved(stage)
        return frame

    def stop(self) -> None:
        self._camera.stop()

    def close(self) -> None:
        self._camera.stop()

    @property
    def status(self) -> CameraStatus:
        return self._camera.status
