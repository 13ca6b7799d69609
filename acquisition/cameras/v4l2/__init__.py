"""UVC and other Video4Linux cameras; on systems without Video4Linux, OpenCV's VideoCapture."""
