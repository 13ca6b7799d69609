"""Frames recorded by another program: a folder of images, a film, a .npy stack."""

from acquisition.cameras.files.frame_source import FilesSettings
