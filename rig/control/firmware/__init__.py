"""Firmware of the controller board (MicroPython): every file of this folder except this one is flashed.

`core` also runs under CPython, where the simulated controller uses it.
"""
