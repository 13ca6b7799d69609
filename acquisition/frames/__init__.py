"""Check, numbering, timing and queueing of frames, between a camera and the code that uses them."""
