"""Analysis of arrays: laser spot, half-cycles, contact laws and fits.

Nothing in this package uses devices, files, clocks or threads.
"""
