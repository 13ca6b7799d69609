"""The simulated rig: dynamics, optics, sensor, disturbances. Shares no formula with the analysis."""
