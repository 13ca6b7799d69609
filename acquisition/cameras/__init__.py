"""Camera drivers, one module or package each; `drivers.py` lists them."""
