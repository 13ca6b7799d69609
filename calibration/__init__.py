"""Pixels to radians, camera ticks to seconds, DN to electrons: each with its budget."""
