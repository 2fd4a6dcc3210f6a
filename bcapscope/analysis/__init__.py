"""Analysis of traffic: findings, slave-mode sessions, statistics, comparison of captures. This package uses
no files, sockets or clock.
"""
