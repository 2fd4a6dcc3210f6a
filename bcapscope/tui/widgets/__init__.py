"""Widgets that several screens share. The widgets post messages, and do not refer to each other."""
