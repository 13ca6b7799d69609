"""What becomes of frames between a camera and whoever takes them: checked, numbered, timed, queued."""
