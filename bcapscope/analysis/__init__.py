"""Findings, slave-mode sessions, statistics and comparison of captures, without files, sockets or clock."""
