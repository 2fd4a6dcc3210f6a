"""Separate processes that read, search and save traffic, and report to the screen.

Only `traffic_feed` runs in the screen's process. Nothing here imports Textual: a process starts at once, and
its work never delays a key.
"""
