"""Traffic, live or recorded: observations, pairing into calls, handles."""
