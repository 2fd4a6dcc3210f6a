"""Separate processes that read, search and save traffic, and report to the screen.

Only `traffic_feed` runs in the screen's process. No module here imports Textual, so the processes start fast.

The work of the processes never delays a key, because the screen has its own process.
"""
