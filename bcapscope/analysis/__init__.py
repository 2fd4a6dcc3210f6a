"""Findings, slave-mode sessions, statistics and comparison of captures. No module uses sockets or a clock."""
