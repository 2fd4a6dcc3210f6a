"""Analysis: findings, slave-mode sessions, statistics and comparison, as pure functions of the traffic."""
