"""What was said, by whom and when, live or recorded: observations and what follows from pairing them."""
