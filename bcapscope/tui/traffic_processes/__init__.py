"""Separate processes that read, search and save traffic, so that their work never delays a key that the user
presses.

Only `traffic_feed` runs in the screen's process. No module here imports Textual, so the processes start fast.
"""
