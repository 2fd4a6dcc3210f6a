"""Widgets that several screens share. They post messages and do not know each other."""
