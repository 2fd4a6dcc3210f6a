"""Widgets that several screens share. The widgets post messages and do not know each other."""
