"""What runs on the controller board (MicroPython): flash every file of this folder but this one.

`core` is plain enough to run under CPython too, where the simulated controller uses it.
"""
