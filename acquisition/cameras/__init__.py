"""One file or folder for each kind of camera; `drivers.py` is their only list."""
