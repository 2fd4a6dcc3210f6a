"""Filter expressions: compile them, and evaluate them on frames and calls."""
