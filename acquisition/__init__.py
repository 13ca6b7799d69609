"""Acquisition of frames and storage in records: cameras, the simulated rig, MCAP files."""
