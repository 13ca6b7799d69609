"""Frames in, records out: cameras, the simulated rig, MCAP records."""
