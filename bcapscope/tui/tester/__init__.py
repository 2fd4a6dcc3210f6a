"""Widgets of the Tester. The widgets post messages and do not know each other."""
