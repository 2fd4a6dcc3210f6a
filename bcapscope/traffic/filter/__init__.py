"""Filter expressions: compile an expression, and evaluate it on frames and calls."""
