"""Widgets of the Tester. The widgets post messages, and do not refer to each other."""
