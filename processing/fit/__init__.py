"""From turning points to friction parameters, and what they are worth."""
