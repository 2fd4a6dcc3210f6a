"""The simulator: a model of a controller without I/O or clock, and the server that adds both."""
