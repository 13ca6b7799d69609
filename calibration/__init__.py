"""Calibrations: pixels to radians, camera clock to seconds, DN to electrons, each with its uncertainties."""
