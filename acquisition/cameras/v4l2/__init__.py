"""UVC and any other Video4Linux camera; OpenCV's VideoCapture where there is no Video4Linux."""
