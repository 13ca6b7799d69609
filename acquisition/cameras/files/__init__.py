"""Frames recorded by another program: a folder of images, a film, a .npy stack."""
