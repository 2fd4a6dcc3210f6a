"""Attacks on everything that listens or reads; run all of them with ``python -m tests.security``."""
