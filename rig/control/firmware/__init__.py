"""Firmware of the controller board (MicroPython): every file of this folder except this one is flashed.

`core` and `lines` also run under CPython, where the simulated controller uses them.
"""
