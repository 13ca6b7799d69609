"""Serial devices of the rig: controller, laser driver, environment sensor."""
