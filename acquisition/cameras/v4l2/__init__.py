"""UVC and other Video4Linux cameras."""
