"""Analysis of traffic, without any I/O: findings, slave-mode sessions, statistics, comparison of captures."""
