"""The simulated rig: dynamics, optics, sensor, disturbances.

It shares no formula with the analysis, so that it can serve as an independent test.
"""
