"""GenApi: a camera's XML turned into features that can be read and set."""
