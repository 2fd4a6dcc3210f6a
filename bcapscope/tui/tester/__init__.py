"""Widgets of the Tester, one per module. The widgets post messages and do not know each other."""
