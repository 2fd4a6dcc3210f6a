"""A controller without a robot: the model (no I/O, time passed in) and the server that moves its bytes."""
