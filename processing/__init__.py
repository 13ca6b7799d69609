"""Analysis of arrays: laser spot, swings, contact laws and fits.

Nothing in this package uses devices, files, clocks or threads.
"""
