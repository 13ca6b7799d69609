"""Arrays in, numbers out: spot, swings, contact laws and fits. No device, no file, no clock, no thread."""
