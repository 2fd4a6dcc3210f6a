"""Separate processes that read, search and save traffic, so that this work never delays a key. Only
`traffic_feed` runs in the screen's process. No module here imports Textual, so the processes start fast.
"""
