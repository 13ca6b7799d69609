"""Tests of what a running session tells, and of the orders it takes."""
