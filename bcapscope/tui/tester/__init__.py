"""Widgets of the Tester, one per module. They post messages and do not know each other."""
