"""Judges from outside: certified values, definitions of standards, other programs."""
