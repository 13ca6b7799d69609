"""Frames recorded by another program: a folder of images, a lossless video, a .npy stack."""

from acquisition.cameras.files.settings import FilesSettings
