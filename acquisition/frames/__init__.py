"""What becomes of frames between a camera and the code that takes them: checked, numbered, timed, queued."""
