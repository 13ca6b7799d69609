"""Rerun, in processes of its own: what is told to them, what they draw, and how they are started."""
