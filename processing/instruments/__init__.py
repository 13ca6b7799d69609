"""The kinds of pendulum: one table of descriptions, and what is reported of each."""
