"""Basler cameras through the vendor's pypylon, an optional package."""
