"""What both ends of a session's loopback port agree on: its file, its address and its paths."""

CHANNEL_NAME = ".channel.json"
LOOPBACK = "127.0.0.1"
WHO = "/who"
"""Asked before anything else: a challenge, which only the session of the file can answer."""
SPECTRA = "spectra"
"""Query of a history that has them, too."""
MOST_ASKED_BYTES = 64 * 1024
