"""A witness of the ground: a record of what moves the pendulum, with a response that is not known."""
