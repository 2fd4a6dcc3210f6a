"""Separate processes that read, search and save traffic. The work of these processes never delays the
screen's response to a key.

Only `traffic_feed` runs in the screen's process. No module here imports Textual, so the processes start fast.
"""
